// All demonstrations, a row each. Only the rows in sight exist, however many there are.

const list = document.getElementById("list");
const rowsBox = document.getElementById("rows");
const ROW = 30; // pixels, as in the style sheet
const rowOf = new Map(); // place -> the row's elements

const lengths = demonstrations.map((one) => one.frames);
const longest = lengths.reduce((a, b) => Math.max(a, b), 1);
const listing = {
  order: [],
  rank: [], // of every place, where it stands in the order
  oneScale: longest <= 3 * lengths.slice().sort((a, b) => a - b)[lengths.length >> 1],
};

function setOrder(name) {
  listing.order = name === "needs" ? placesByNeed() : demonstrations.map((one) => one.place);
  listing.order.forEach((place, rank) => {
    listing.rank[place] = rank;
  });
  rowsBox.style.height = `${listing.order.length * ROW}px`;
  rowsBox.replaceChildren();
  rowOf.clear();
}

function stepTo(way) {
  const rank = listing.rank[ui.place] + way;
  if (rank < 0 || rank >= listing.order.length) return say("There is no other demonstration that way.");
  select(listing.order[rank]);
  scrollToRow();
  const one = current();
  const count = currentSegments().length;
  return say(`Demonstration ${one.episode}: ${one.frames} frames, ${count} segments.`);
}

function scrollToRow() {
  const top = listing.rank[ui.place] * ROW;
  if (top < list.scrollTop) list.scrollTop = top;
  else if (top + ROW > list.scrollTop + list.clientHeight) list.scrollTop = top + ROW - list.clientHeight;
}

function newRow(place) {
  const one = demonstrations[place];
  const row = document.createElement("div");
  const [number, canvas, meta] = ["span", "canvas", "span"].map((tag) => document.createElement(tag));
  row.id = `row-${place}`;
  row.className = "demonstration";
  row.setAttribute("role", "option");
  row.setAttribute("aria-posinset", listing.rank[place] + 1);
  row.setAttribute("aria-setsize", listing.order.length);
  row.style.top = `${listing.rank[place] * ROW}px`;
  row.dataset.place = place;
  number.className = "number";
  number.textContent = one.episode;
  canvas.setAttribute("aria-hidden", "true");
  meta.className = "meta";
  row.append(number, canvas, meta);
  rowsBox.append(row);
  const parts = { row, canvas, meta, number };
  rowOf.set(place, parts);
  return parts;
}

function rowView(place, canvas) {
  const { frames } = demonstrations[place];
  return { from: 0, to: listing.oneScale ? longest : frames, width: canvas.clientWidth };
}

function drawRow(place) {
  const one = demonstrations[place];
  const parts = rowOf.get(place) || newRow(place);
  const segments = place === ui.place ? currentSegments() : history.state.segments[place];
  const chosen = place === ui.place;
  const edited = isEdited(history.state, place);
  const view = rowView(place, parts.canvas);
  const height = parts.canvas.clientHeight;
  const context = prepared(parts.canvas, view.width, height);
  const band = one.truth ? height - 6 : height;
  drawStages(context, segments, history.state.stages, one.frames, view, 0, band, false);
  if (!edited) fadeUnsure(context, one, view, 0, band);
  drawStretches(context, one.idle, view, band - 7, 7, hatch(context));
  drawStretches(context, one.corrected, view, 0, 2, theme.ink);
  if (one.truth) drawTruth(context, one, view, height - 5, 5, false);
  if (chosen) drawCursor(context, view, height, false);
  const sure = meanConfidence(one, 0, one.frames).toFixed(2);
  const count = `${segments.length} part${segments.length === 1 ? "" : "s"}`;
  parts.meta.textContent = `${edited ? "edited" : sure} · ${count}`;
  parts.row.classList.toggle("chosen", chosen);
  parts.row.classList.toggle("edited", edited);
  parts.row.setAttribute("aria-selected", chosen);
  parts.row.setAttribute(
    "aria-label",
    `Demonstration ${one.episode}, ${one.frames} frames, ${count}, confidence ${sure}${edited ? ", edited" : ""}`,
  );
}

function drawList() {
  const first = Math.max(0, Math.floor(list.scrollTop / ROW));
  const last = Math.min(listing.order.length, Math.ceil((list.scrollTop + list.clientHeight) / ROW));
  const seen = new Set(listing.order.slice(first, last));
  for (const [place, { row }] of rowOf) {
    if (seen.has(place)) continue;
    row.remove();
    rowOf.delete(place);
  }
  seen.forEach(drawRow);
  // Who cannot see the rows hears them in the document's order.
  [...seen].forEach((place, k) => {
    const { row } = rowOf.get(place);
    if (rowsBox.children[k] !== row) rowsBox.insertBefore(row, rowsBox.children[k]);
  });
  if (seen.has(ui.place)) list.setAttribute("aria-activedescendant", `row-${ui.place}`);
  else list.removeAttribute("aria-activedescendant");
}

function rowFrame(event) {
  const row = event.target.closest(".demonstration");
  if (!row) return null;
  const place = Number(row.dataset.place);
  const { canvas } = rowOf.get(place);
  const x = event.clientX - canvas.getBoundingClientRect().left;
  const frame = Math.floor(frameAt(rowView(place, canvas), x));
  return { place, frame: Math.max(0, Math.min(demonstrations[place].frames - 1, frame)), inside: x >= 0 };
}

list.addEventListener("click", (event) => {
  const found = rowFrame(event);
  if (found) select(found.place, found.inside ? found.frame : 0);
});

list.addEventListener("pointermove", (event) => {
  ui.hover = event.pointerType === "mouse" ? rowFrame(event) : null;
  draw();
});

list.addEventListener("pointerleave", () => {
  ui.hover = null;
  draw();
});

list.addEventListener("scroll", () => draw(), { passive: true });
