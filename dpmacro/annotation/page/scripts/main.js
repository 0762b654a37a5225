// Keys, buttons, and the file of corrections.

const keysDialog = document.getElementById("keys");
const statusLine = document.getElementById("status");
let awaited = 0;
let savedState = opened;

function say(text) {
  statusLine.textContent = text;
}

function drawNow() {
  cancelAnimationFrame(awaited);
  awaited = 0;
  drawStageList();
  drawStrip();
  drawPlot();
  drawList();
  drawReadout();
  const edited = editedPlaces(history.state).length;
  document.getElementById("save").textContent = `Save corrections${edited ? ` (${edited})` : ""}`;
  document.getElementById("undo").disabled = !history.past.length;
  document.getElementById("redo").disabled = !history.future.length;
  document.getElementById("hold").setAttribute("aria-pressed", ui.held !== null);
}

// However much happens at once, all is drawn once before the screen shows it.
function draw() {
  if (!awaited) awaited = requestAnimationFrame(drawNow);
}

// Undo and redo: what they change is brought into sight.
function travel(step, done, nothing) {
  letGo();
  const before = history.state.segments;
  if (!step()) return say(nothing);
  const changed = demonstrations.filter(({ place }) => history.state.segments[place] !== before[place]);
  if (changed.length === 1 && changed[0].place !== ui.place) {
    select(changed[0].place);
    scrollToRow();
  }
  const leftOut = history.state === firstState && opened !== firstState;
  say(leftOut ? "Undone: all corrections made earlier are left out. Redo brings them back." : done);
  return draw();
}

const undo = () => travel(stepBack, "Undone.", "There is nothing to undo.");
const redo = () => travel(stepForward, "Done again.", "There is nothing to do again.");

function save() {
  if (document.activeElement.matches("#stages input")) document.activeElement.blur(); // takes the name typed
  if (!isChanged(history.state) && !isChanged(opened)) return say("Nothing has been changed yet.");
  const text = `${JSON.stringify(corrections(history.state), null, 1)}\n`;
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type: "application/json" }));
  link.download = `${data.dataset.replace(/[^\p{L}\p{N}._-]+/gu, "_") || "dataset"}-corrections.json`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
  savedState = history.state;
  const count = editedPlaces(history.state).length;
  return say(`Saved ${link.download}: ${count} edited demonstration${count === 1 ? "" : "s"}.`);
}

async function openFile(file) {
  let state = null;
  try {
    state = stateFrom(JSON.parse(await file.text()));
  } catch (error) {
    return say(`${file.name} was not opened: ${error.message}.`);
  }
  change(state, `${file.name} opened.`);
  savedState = state;
  return select(ui.place, ui.frame);
}

// In focus is the heading, not the first field: on a small screen that one may be far below.
function showKeys() {
  keysDialog.showModal();
  document.getElementById("keys-heading").focus();
}

function toggleLines() {
  const box = document.getElementById("curves");
  const toggle = document.getElementById("lines");
  if (!toggle) return;
  box.hidden = !box.hidden;
  toggle.setAttribute("aria-expanded", !box.hidden);
  draw();
}

// At first the lines that tell the stages apart best.
const first = data.curves.map((_, k) => k).sort((a, b) => data.curves[b].explained - data.curves[a].explained);
first.splice(4);

data.curves.forEach(({ name }, k) => {
  const label = document.createElement("label");
  const box = document.createElement("input");
  box.type = "checkbox";
  box.checked = first.includes(k);
  if (box.checked) ui.lines.add(k);
  box.addEventListener("change", () => {
    if (box.checked) ui.lines.add(k);
    else ui.lines.delete(k);
    draw();
  });
  label.append(box, ` ${name}`);
  document.getElementById("choices").append(label);
});

function move(by) {
  if (ui.held) moveHeld(by);
  else setFrame(ui.frame + by);
}

const second = Math.max(1, Math.round(data.fps));
const KEYS = {
  ArrowLeft: () => move(-1),
  ArrowRight: () => move(1),
  PageUp: () => move(-second),
  PageDown: () => move(second),
  Home: () => move(-current().frames),
  End: () => move(current().frames),
  n: () => stepToCut(1),
  p: () => stepToCut(-1),
  j: () => stepTo(1),
  k: () => stepTo(-1),
  a: addCut,
  d: deleteCut,
  Delete: deleteCut,
  f: takeBack,
  u: undo,
  U: redo,
  "+": () => zoom(0.5),
  "=": () => zoom(0.5),
  "-": () => zoom(2),
  0: () => zoom(Infinity),
  l: toggleLines,
  "?": showKeys,
  Escape: putBack,
};
const OF_THE_STRIP = {
  Enter: toggleHold,
  " ": toggleHold,
  ArrowDown: () => stepTo(1),
  ArrowUp: () => stepTo(-1),
  "Shift ArrowLeft": () => move(-10),
  "Shift ArrowRight": () => move(10),
};
const WITH_CONTROL = { z: undo, Z: redo, y: redo, s: save };

document.addEventListener("keydown", (event) => {
  const { target, key } = event;
  if (document.querySelector("dialog[open]") || event.altKey) return;
  if (event.ctrlKey || event.metaKey) {
    const act = WITH_CONTROL[key];
    // In a text field Ctrl Z is the field's own.
    if (!act || (act !== save && target.matches("input:not([type=checkbox])"))) return;
    event.preventDefault();
    act();
    return;
  }
  if (target.matches("input:not([type=checkbox]), select")) return;
  const within = target === strip || target === list;
  if (!within && !document.getElementById("anywhere").checked) return;
  // A button or link in focus keeps Enter and Space, and the page scrolls by Up, Down and Page keys.
  const free = within || target === document.body;
  const shifted = event.shiftKey && key.startsWith("Arrow") ? `Shift ${key}` : key;
  let act = null;
  if (/^[1-9]$/.test(key)) act = () => assign(Number(key) - 1);
  else if (shifted in OF_THE_STRIP) act = free && (within || !/^Arrow(Up|Down)$/.test(key)) ? OF_THE_STRIP[shifted] : null;
  else if (/^(Page|Home|End)/.test(key)) act = within ? KEYS[key] : null;
  else if (Object.hasOwn(KEYS, key)) act = KEYS[key];
  if (!act) return;
  event.preventDefault();
  if (target === document.body) strip.focus({ preventScroll: true }); // from here on Home and End are its own
  act();
});

const chosenFile = document.getElementById("file");
chosenFile.addEventListener("change", () => {
  if (chosenFile.files.length) openFile(chosenFile.files[0]);
  chosenFile.value = ""; // the same file may be chosen again
});

const BUTTONS = {
  open: () => chosenFile.click(),
  undo,
  redo,
  save,
  help: showKeys,
  "previous-cut": () => stepToCut(-1),
  "next-cut": () => stepToCut(1),
  hold: () => {
    toggleHold();
    strip.focus();
  },
  "add-cut": addCut,
  "delete-cut": deleteCut,
  "as-found": takeBack,
  "zoom-in": KEYS["+"],
  "zoom-out": KEYS["-"],
  "zoom-fit": KEYS[0],
  lines: toggleLines,
};
for (const [id, act] of Object.entries(BUTTONS)) {
  const found = document.getElementById(id);
  if (found) found.addEventListener("click", act);
}

document.getElementById("order").addEventListener("change", (event) => {
  setOrder(event.target.value);
  list.scrollTop = 0;
  select(listing.order[0]);
});

const scale = document.getElementById("scale");
scale.checked = listing.oneScale;
scale.addEventListener("change", () => {
  listing.oneScale = scale.checked;
  draw();
});

window.addEventListener("beforeunload", (event) => {
  const differ = history.state !== savedState && (isChanged(history.state) || isChanged(opened));
  if (differ) event.preventDefault();
});

function restyle() {
  readTheme();
  stagesShown = null; // the swatches have a colour of the theme
  draw();
}
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", restyle);
new ResizeObserver(draw).observe(document.body);

readTheme();
setOrder("needs");
select(listing.order[0]);
