// The demonstration at hand: its strip in large, the cursor, cuts that are dragged, its lines.

const strip = document.getElementById("strip");
const plot = document.getElementById("plot");
const LEAST_SPAN = 12; // frames shown at most closely
const LINE_HEIGHT = 38;
const NEAR = { mouse: 6, pen: 8, touch: 16 }; // pixels from a cut within which a pointer takes it

const ui = {
  place: 0, // of the demonstration at hand
  frame: 0, // under the cursor
  from: 0, // the frames in view
  to: 1,
  hover: null, // {place, frame} under the mouse
  held: null, // {cut, before}: the cut that the arrow keys move, and the state before
  drag: null, // {cut, before, segments} or {scrub: true}
  lines: new Set(), // curves drawn
};

// Rows of the strip, from top to bottom, in pixels.
const layout = { ruler: 20, band: 54, confidence: 26, truth: data.truth ? 20 : 0 };
layout.height = layout.ruler + layout.band + 4 + layout.confidence + (layout.truth && layout.truth + 4);

function current() {
  return demonstrations[ui.place];
}

// The segments at hand, those of a drag while it lasts.
function currentSegments() {
  return ui.drag && ui.drag.segments ? ui.drag.segments : history.state.segments[ui.place];
}

function stripView() {
  return { from: ui.from, to: ui.to, width: strip.clientWidth };
}

function select(place, frame = 0) {
  letGo();
  ui.place = place;
  ui.from = 0;
  ui.to = current().frames;
  setFrame(frame);
}

function setFrame(frame) {
  const last = current().frames - 1;
  ui.frame = Math.max(0, Math.min(last, Math.round(frame)));
  const span = ui.to - ui.from;
  if (ui.frame < ui.from) pan(ui.frame - span * 0.1);
  else if (ui.frame >= ui.to) pan(ui.frame - span * 0.9);
  draw();
}

function pan(from) {
  const span = ui.to - ui.from;
  ui.from = Math.max(0, Math.min(current().frames - span, from));
  ui.to = ui.from + span;
}

// Zooms so that the frame under `x` stays there.
function zoom(factor, x = xOf(stripView(), ui.frame)) {
  const view = stripView();
  const frames = current().frames;
  const span = Math.min(frames, Math.max(Math.min(LEAST_SPAN, frames), (ui.to - ui.from) * factor));
  const fixed = frameAt(view, x);
  ui.from = fixed - (x / view.width) * span;
  ui.to = ui.from + span;
  pan(ui.from);
  draw();
}

function drawStrip() {
  const height = layout.height;
  const one = current();
  const view = stripView();
  const segments = currentSegments();
  const { stages } = history.state;
  strip.style.height = `${height}px`;
  const context = prepared(strip, view.width, height);
  let top = layout.ruler;
  drawRuler(context, view, 8, flagEdges(context, view));
  drawStages(context, segments, stages, one.frames, view, top, layout.band, true);
  drawStretches(context, one.idle, view, top + layout.band - 12, 12, hatch(context));
  drawStretches(context, one.corrected, view, top, 3, theme.ink);
  top += layout.band + 4;
  drawConfidence(context, one, view, top, layout.confidence);
  if (one.truth) drawTruth(context, one, view, top + layout.confidence + 4, layout.truth, true);
  drawCursor(context, view, height);
  drawCuts(context, segments, view);
  tellStrip(one, segments, stages);
}

function drawCuts(context, segments, view) {
  for (let k = 1; k < segments.length; k++) {
    const x = Math.round(xOf(view, segments[k].start));
    if (x < -6 || x > view.width + 6) continue;
    const taken = (ui.held && ui.held.cut === k) || (ui.drag && ui.drag.cut === k);
    const same = segments[k].label === segments[k - 1].label;
    context.strokeStyle = context.fillStyle = taken ? theme.accent : theme.ink;
    context.lineWidth = taken ? 3 : 1.5;
    context.setLineDash(same ? [4, 3] : []);
    context.beginPath();
    context.moveTo(x, layout.ruler - 2);
    context.lineTo(x, layout.ruler + layout.band + 2);
    context.stroke();
    context.setLineDash([]);
    context.beginPath();
    context.arc(x, layout.ruler + layout.band + 2, taken ? 6 : 4, 0, 2 * Math.PI);
    context.fill();
  }
  context.lineWidth = 1;
}

// Where the cursor's frame is written above the strip.
function flagEdges(context, view) {
  const x = xOf(view, ui.frame);
  const wide = context.measureText(String(ui.frame)).width + 8;
  const left = Math.max(0, Math.min(view.width - wide, x - wide / 2));
  return [left, left + wide];
}

// A line in the paper's colour round the cursor keeps it visible on every stage.
function drawCursor(context, view, height, flag = true) {
  const x = Math.round(xOf(view, ui.frame)) + 0.5;
  if (x < 0 || x > view.width + 1) return;
  for (const [width, colour] of [[4, theme.paper], [2, theme.accent]]) {
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.beginPath();
    context.moveTo(x, flag ? 16 : 0);
    context.lineTo(x, height);
    context.stroke();
  }
  context.lineWidth = 1;
  if (!flag) return;
  const [left, right] = flagEdges(context, view);
  context.fillStyle = theme.accent;
  context.fillRect(left, 0, right - left, 16);
  context.fillStyle = inkOn(theme.accent);
  context.fillText(String(ui.frame), left + 4, 8.5);
}

function stageAt(place, frame, segments) {
  return history.state.stages[segments[runAt(segments, frame)].label];
}

function tellStrip(one, segments, stages) {
  const at = runAt(segments, ui.frame);
  const stage = stages[segments[at].label];
  const held = ui.held ? ", cut held" : segments[at].start === ui.frame && at ? ", at a cut" : "";
  strip.setAttribute("aria-label", `Demonstration ${one.episode}, cursor`);
  strip.setAttribute("aria-valuemax", one.frames - 1);
  strip.setAttribute("aria-valuenow", ui.frame);
  strip.setAttribute(
    "aria-valuetext",
    `frame ${ui.frame} of ${one.frames}, ${secondsAt(one, ui.frame).toFixed(2)} s, ${stage.name}${held}`,
  );
}

// What stands beside the pictures: of the frame under the mouse, else of the cursor.
function drawReadout() {
  const { place, frame } = ui.hover || ui;
  const one = demonstrations[place];
  const segments = place === ui.place ? currentSegments() : history.state.segments[place];
  const edited = isEdited(history.state, place);
  const rows = [
    ["frame", `${frame} of ${one.frames}`],
    ["time", `${secondsAt(one, frame).toFixed(2)} s`],
    ["stage", stageAt(place, frame, segments).name],
    ["confidence", `${(one.confidence[frame] / 255).toFixed(2)}${edited ? ", before your changes" : ""}`],
  ];
  if (one.truth) {
    rows.push([data.truth.column, data.truth.names[one.truth[runAt(one.truth, frame)].label]]);
  }
  if (one.idle.some(([start, end]) => start <= frame && frame < end)) rows.push(["motion", "none"]);
  const byPerson = one.corrected.some(([start, end]) => start <= frame && frame < end);
  if (byPerson || isEarlier(history.state, place)) rows.push(["source", "a person, earlier"]);
  const list = document.getElementById("readout");
  list.replaceChildren(
    ...rows.flatMap(([name, value]) => {
      const [term, text] = [document.createElement("dt"), document.createElement("dd")];
      term.textContent = name;
      text.textContent = value;
      return [term, text];
    }),
  );
  document.getElementById("editor-heading").textContent = `Demonstration ${one.episode}${edited ? ", edited" : ""}`;
  drawPictures(place, frame, draw);
}

function drawPlot() {
  if (!ui.lines.size || document.getElementById("curves").hidden) {
    plot.hidden = true;
    return;
  }
  plot.hidden = false;
  const one = current();
  const height = ui.lines.size * LINE_HEIGHT;
  plot.style.height = `${height}px`;
  const view = { ...stripView(), width: plot.clientWidth };
  const context = prepared(plot, view.width, height);
  let top = 0;
  for (const line of [...ui.lines].sort((a, b) => a - b)) {
    const { name, low, high } = data.curves[line];
    const values = one.curves[line];
    context.strokeStyle = theme.line;
    context.beginPath();
    context.moveTo(0, top + LINE_HEIGHT - 0.5);
    context.lineTo(view.width, top + LINE_HEIGHT - 0.5);
    context.stroke();
    drawCurve(context, values, data.curve_step, view, top, LINE_HEIGHT);
    const level = values[Math.floor(ui.frame / data.curve_step)];
    const value = level === 255 ? "none" : (low + (level / 254) * (high - low)).toPrecision(3);
    const text = `${name} ${value}`;
    context.fillStyle = theme.paper;
    context.globalAlpha = 0.8;
    context.fillRect(0, top + 2, context.measureText(text).width + 8, 15);
    context.globalAlpha = 1;
    context.fillStyle = theme.ink;
    context.fillText(text, 4, top + 10);
    top += LINE_HEIGHT;
  }
  drawCursor(context, view, height, false);
}

function pointerFrame(event) {
  const x = event.clientX - strip.getBoundingClientRect().left;
  return frameAt(stripView(), x);
}

function cutUnder(event) {
  const segments = currentSegments();
  const view = stripView();
  const x = event.clientX - strip.getBoundingClientRect().left;
  const cut = nearestCut(segments, frameAt(view, x));
  const near = NEAR[event.pointerType] || NEAR.mouse;
  return cut && Math.abs(xOf(view, segments[cut].start) - x) <= near ? cut : 0;
}

strip.addEventListener("pointerdown", (event) => {
  if (event.button !== 0) return;
  letGo();
  const cut = cutUnder(event);
  ui.hover = null;
  strip.setPointerCapture(event.pointerId);
  if (cut) {
    ui.drag = { cut, segments: currentSegments() };
    setFrame(ui.drag.segments[cut].start);
  } else {
    ui.drag = { scrub: true };
    setFrame(Math.floor(pointerFrame(event)));
  }
});

strip.addEventListener("pointermove", (event) => {
  if (!ui.drag) {
    strip.style.cursor = cutUnder(event) ? "ew-resize" : "default";
    const frame = Math.max(0, Math.min(current().frames - 1, Math.floor(pointerFrame(event))));
    ui.hover = event.pointerType === "mouse" ? { place: ui.place, frame } : null;
    draw();
  } else if (ui.drag.cut) {
    const { cut, segments } = ui.drag;
    const frame = clampedCut(segments, cut, Math.round(pointerFrame(event)), current().frames);
    ui.drag.segments = withCutMoved(segments, cut, frame);
    setFrame(frame);
  } else setFrame(Math.floor(pointerFrame(event)));
});

strip.addEventListener("pointerup", () => {
  const { drag } = ui;
  ui.drag = null;
  if (drag && drag.cut) {
    const { start } = drag.segments[drag.cut];
    if (start !== currentSegments()[drag.cut].start) changeSegments(drag.segments, `Cut before frame ${start}.`);
  }
  draw();
});

strip.addEventListener("pointercancel", () => {
  ui.drag = null;
  draw();
});

strip.addEventListener("pointerleave", () => {
  ui.hover = null;
  draw();
});

strip.addEventListener(
  "wheel",
  (event) => {
    const sideways = event.shiftKey ? event.deltaY : event.deltaX;
    if (event.ctrlKey) zoom(Math.exp(event.deltaY / 300), event.offsetX);
    else if (Math.abs(sideways) > Math.abs(event.shiftKey ? 0 : event.deltaY)) {
      pan(ui.from + (sideways / strip.clientWidth) * (ui.to - ui.from));
      draw();
    } else return;
    event.preventDefault();
  },
  { passive: false },
);
