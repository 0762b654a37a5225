// Strips on canvases: stages, their confidence, true labels, stretches without motion, lines of numbers.
// A view is {from, to, width}: the frames from `from` to `to` stand between the pixels 0 and `width`.

const theme = {};

function readTheme() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["ink", "faint", "line", "paper", "accent", "black"]) {
    theme[name] = style.getPropertyValue(`--${name}`).trim();
  }
  theme.font = `12px ${getComputedStyle(document.body).fontFamily}`;
  theme.hatch = null;
}

function colourOf(stage) {
  const colour = data.colours[stage.colour % data.colours.length];
  return colour === "#000000" ? theme.black : colour;
}

function inkOn(colour) {
  const [red, green, blue] = [1, 3, 5].map((k) => parseInt(colour.slice(k, k + 2), 16) / 255);
  return 0.3 * red + 0.59 * green + 0.11 * blue < 0.55 ? "#ffffff" : "#16191c";
}

// The canvas's context, cleared, in CSS pixels, however many of the screen's these are.
function prepared(canvas, width, height) {
  const ratio = window.devicePixelRatio || 1;
  const size = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== size[0]) canvas.width = size[0];
  if (canvas.height !== size[1]) canvas.height = size[1];
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = theme.font;
  context.textBaseline = "middle";
  return context;
}

function xOf(view, frame) {
  return ((frame - view.from) / (view.to - view.from)) * view.width;
}

function frameAt(view, x) {
  return view.from + (x / view.width) * (view.to - view.from);
}

// Calls draw(run, left, right) for the runs that the view shows.
function forVisible(runs, frames, view, draw) {
  for (let k = runAt(runs, Math.max(0, Math.floor(view.from))); k < runs.length; k++) {
    if (runs[k].start > view.to) break;
    const left = Math.max(0, xOf(view, runs[k].start));
    const right = Math.min(view.width, xOf(view, endOf(runs, k, frames)));
    if (right > left) draw(runs[k], left, right, k);
  }
}

// Text within a box, shortened where it does not fit; nothing where not even a letter does.
function writeWithin(context, text, left, right, middle) {
  const room = right - left - 10;
  if (room < 8) return;
  let shown = text;
  if (context.measureText(text).width > room) {
    let count = Math.floor((text.length * room) / context.measureText(text).width);
    while (count > 0 && context.measureText(`${text.slice(0, count)}…`).width > room) count--;
    shown = count > 0 ? `${text.slice(0, count)}…` : "";
  }
  context.fillText(shown, left + 5, middle);
}

function drawStages(context, segments, stages, frames, view, top, height, named) {
  forVisible(segments, frames, view, (run, left, right) => {
    const colour = colourOf(stages[run.label]);
    context.fillStyle = colour;
    context.fillRect(left, top, right - left, height);
    if (!named) return;
    context.fillStyle = inkOn(colour);
    const name = `${run.label + 1} ${stages[run.label].name}`;
    writeWithin(context, name, left, right, top + height / 2);
  });
}

// Where labels are unsure the paper shows through, by the mean confidence over every two pixels.
function fadeUnsure(context, demonstration, view, top, height) {
  const steps = 8;
  let last = 0;
  let since = 0;
  context.fillStyle = theme.paper;
  const flush = (x) => {
    if (last > 0 && x > since) {
      context.globalAlpha = (0.8 * last) / steps;
      context.fillRect(since, top, x - since, height);
    }
  };
  const end = Math.min(view.width, xOf(view, demonstration.frames));
  for (let x = Math.max(0, xOf(view, 0)); x < end; x += 2) {
    const from = Math.max(0, Math.min(demonstration.frames - 1, Math.floor(frameAt(view, x))));
    const to = Math.max(from + 1, Math.min(demonstration.frames, Math.floor(frameAt(view, x + 2))));
    const level = Math.round((1 - meanConfidence(demonstration, from, to)) * steps);
    if (level !== last) {
      flush(x);
      last = level;
      since = x;
    }
  }
  flush(end);
  context.globalAlpha = 1;
}

function hatch(context) {
  if (!theme.hatch) {
    const tile = document.createElement("canvas");
    tile.width = tile.height = 8;
    const own = tile.getContext("2d");
    for (const [colour, offset] of [["rgba(255,255,255,0.75)", 1], ["rgba(0,0,0,0.65)", 0]]) {
      own.strokeStyle = colour;
      own.lineWidth = 1;
      own.beginPath();
      for (const shift of [-8, 0, 8]) {
        own.moveTo(shift + offset, 8);
        own.lineTo(shift + offset + 8, 0);
      }
      own.stroke();
    }
    theme.hatch = context.createPattern(tile, "repeat");
  }
  return theme.hatch;
}

function drawStretches(context, stretches, view, top, height, fill) {
  context.fillStyle = fill;
  for (const [start, end] of stretches) {
    if (end < view.from || start > view.to) continue;
    const left = Math.max(0, xOf(view, start));
    context.fillRect(left, top, Math.min(view.width, xOf(view, end)) - left, height);
  }
}

function drawTruth(context, demonstration, view, top, height, named) {
  forVisible(demonstration.truth, demonstration.frames, view, (run, left, right) => {
    const grey = data.greys[run.label % data.greys.length];
    context.fillStyle = grey;
    context.fillRect(left, top, right - left, height);
    if (!named) return;
    context.fillStyle = inkOn(grey);
    writeWithin(context, data.truth.names[run.label], left, right, top + height / 2);
  });
}

// The least confidence under every pixel, as an area: short doubts stay visible in long demonstrations.
function drawConfidence(context, demonstration, view, top, height) {
  context.strokeStyle = theme.line;
  context.strokeRect(0.5, top + 0.5, view.width - 1, height - 1);
  context.fillStyle = theme.faint;
  context.globalAlpha = 0.55;
  context.beginPath();
  context.moveTo(0, top + height);
  for (let x = 0; x < view.width; x++) {
    const from = Math.min(demonstration.frames - 1, Math.max(0, Math.floor(frameAt(view, x))));
    const to = Math.min(demonstration.frames, Math.max(from + 1, Math.floor(frameAt(view, x + 1))));
    let least = 255;
    for (let k = from; k < to; k++) least = Math.min(least, demonstration.confidence[k]);
    const y = top + height - (least / 255) * height;
    context.lineTo(x, y);
    context.lineTo(x + 1, y);
  }
  context.lineTo(view.width, top + height);
  context.fill();
  context.globalAlpha = 1;
  context.fillStyle = theme.ink;
  writeWithin(context, "confidence", 0, view.width, top + height / 2);
}

const STEPS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 1800, 3600];

// Ticks in seconds; none is written where the cursor's frame stands, between `left` and `right`.
function drawRuler(context, view, middle, [flagLeft, flagRight]) {
  const span = (view.to - view.from) / data.fps;
  const step = STEPS.find((one) => (one / span) * view.width >= 60) || 7200;
  context.fillStyle = theme.faint;
  context.strokeStyle = theme.line;
  context.beginPath();
  for (let k = Math.ceil(view.from / data.fps / step); k * step * data.fps <= view.to; k++) {
    const x = xOf(view, k * step * data.fps);
    context.moveTo(x + 0.5, middle + 6);
    context.lineTo(x + 0.5, middle + 11);
    const text = `${Number((k * step).toFixed(1))} s`;
    const wide = context.measureText(text).width;
    const left = Math.min(view.width - wide, Math.max(0, x - wide / 2));
    if (left > flagRight + 4 || left + wide < flagLeft - 4) context.fillText(text, left, middle);
  }
  context.stroke();
}

// One number along time, by the least and the most under every pixel; bytes of 255 are no values.
function drawCurve(context, values, step, view, top, height) {
  const y = (value) => top + height - 3 - (value / 254) * (height - 6);
  context.strokeStyle = theme.ink;
  context.lineWidth = 1.25;
  context.beginPath();
  let open = false;
  const dense = (view.to - view.from) / step > 2 * view.width;
  const first = Math.max(0, Math.floor(view.from / step) - 1);
  const last = Math.min(values.length - 1, Math.ceil(view.to / step) + 1);
  let k = first;
  while (k <= last) {
    const x = xOf(view, k * step);
    let [low, high] = [values[k], values[k]];
    if (dense) {
      for (; k < last && xOf(view, (k + 1) * step) < x + 1; k++) {
        const next = values[k + 1];
        if (next === 255) continue;
        low = low === 255 ? next : Math.min(low, next);
        high = high === 255 ? next : Math.max(high, next);
      }
    }
    k++;
    if (low === 255) {
      open = false;
      continue;
    }
    if (open) context.lineTo(x, y(low));
    else context.moveTo(x, y(low));
    if (high !== low) context.lineTo(x, y(high));
    open = true;
  }
  context.stroke();
  context.lineWidth = 1;
}
