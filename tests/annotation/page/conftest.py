"""A headless Chromium, where there is one, that fails tests whose page complains or asks for anything."""

import shutil
from contextlib import contextmanager

import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


@pytest.fixture(scope="session")
def browser():
    """Playwright's own Chromium or the system's."""
    playwright = pytest.importorskip("playwright.sync_api", reason="no browser tests: playwright is not here")
    with playwright.sync_playwright() as started:
        paths = [None, *filter(None, map(shutil.which, BROWSERS))]
        launched, failure = None, ""
        for path in paths:
            try:
                launched = started.chromium.launch(executable_path=path)
                break
            except playwright.Error as error:
                failure = str(error).splitlines()[0]
        if launched is None:
            pytest.skip(f"no browser tests: no Chromium starts (apt-get install chromium): {failure}")
        yield launched
        launched.close()


@pytest.fixture
def opened(browser):
    """A context manager: opens a file in a tab of its own, with options of Playwright's contexts."""

    @contextmanager
    def open_(path, width=1280, height=900, **context):
        own = browser.new_context(viewport={"width": width, "height": height}, **context)
        tab, complaints, asked = own.new_page(), [], []
        tab.on("console", lambda message: complaints.append(message.text))
        tab.on("pageerror", lambda error: complaints.append(str(error)))
        tab.on("request", lambda request: asked.append(request.url))
        tab.goto(path.as_uri())
        settle(tab)
        yield tab
        settle(tab)
        own.close()
        assert not complaints
        assert {url for url in asked if not url.startswith(("data:", "blob:"))} == {path.as_uri()}

    return open_


def settle(tab):
    """Waits until what was asked for is drawn."""
    tab.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
