// The data that the page carries, with what is encoded compactly as typed arrays.

const data = JSON.parse(document.getElementById("data").textContent);

function bytesOf(base64) {
  const text = atob(base64);
  const bytes = new Uint8Array(text.length);
  for (let k = 0; k < text.length; k++) bytes[k] = text.charCodeAt(k);
  return bytes;
}

// A value that is computed when first asked for: 100 demonstrations need not be decoded to show one.
function lazily(object, name, compute) {
  Object.defineProperty(object, name, {
    configurable: true,
    get() {
      const value = compute();
      Object.defineProperty(object, name, { value });
      return value;
    },
  });
}

const demonstrations = data.demonstrations.map((stored, place) => {
  const one = { ...stored, place };
  one.segments = stored.segments.map(([start, label]) => ({ start, label }));
  one.truth = stored.truth && stored.truth.map(([start, label]) => ({ start, label }));
  lazily(one, "confidence", () => bytesOf(stored.confidence));
  lazily(one, "curves", () => stored.curves.map(bytesOf));
  lazily(one, "seconds", () => stored.seconds && new Float32Array(bytesOf(stored.seconds).buffer));
  // Sums of the confidence before every frame: the mean over any stretch in one step.
  lazily(one, "sums", () => {
    const sums = new Float64Array(one.frames + 1);
    for (let k = 0; k < one.frames; k++) sums[k + 1] = sums[k] + one.confidence[k] / 255;
    return sums;
  });
  return one;
});

function meanConfidence(demonstration, from, to) {
  return (demonstration.sums[to] - demonstration.sums[from]) / (to - from);
}

function secondsAt(demonstration, frame) {
  return demonstration.seconds ? demonstration.seconds[frame] : frame / data.fps;
}

// The place in `runs` (segments or true runs, ascending by start) of the one that holds a frame.
function runAt(runs, frame) {
  let low = 0;
  let high = runs.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (runs[middle].start <= frame) low = middle;
    else high = middle - 1;
  }
  return low;
}

function endOf(runs, place, frames) {
  return place + 1 < runs.length ? runs[place + 1].start : frames;
}

// First those whose labels are least sure, to a hundredth; among equals those with the most unusual number
// of segments; last those that a person corrected earlier.
function placesByNeed() {
  const counts = demonstrations.map((one) => one.segments.length).sort((a, b) => a - b);
  const median = counts[counts.length >> 1];
  const need = demonstrations.map((one) => [
    opened.held.has(one.place) ? 101 : Math.round(meanConfidence(one, 0, one.frames) * 100),
    -Math.abs(one.segments.length - median),
    one.place,
  ]);
  need.sort((a, b) => a[0] - b[0] || a[1] - b[1] || a[2] - b[2]);
  return need.map((row) => row[2]);
}
