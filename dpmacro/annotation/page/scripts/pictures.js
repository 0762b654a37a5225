// What every camera saw at a frame, cut out of the sheets of small pictures.

const KEPT_SHEETS = 24; // decoded at a time: a sheet is some megabytes of memory
const sheetImages = new Map();

const cameraViews = data.cameras.map((name) => {
  const figure = document.createElement("figure");
  const canvas = document.createElement("canvas");
  const caption = document.createElement("figcaption");
  canvas.setAttribute("role", "img");
  caption.textContent = name;
  figure.append(canvas, caption);
  document.getElementById("cameras").append(figure);
  return { name, canvas, caption };
});

// The sheet with the picture nearest to a frame, and that picture's place on it; null where there is none.
function nearestPicture(sheets, frame) {
  let best = null;
  for (const sheet of sheets) {
    const { frames } = sheet;
    let low = 0;
    let high = frames.length - 1;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (frames[middle] < frame) low = middle + 1;
      else high = middle;
    }
    if (low > 0 && frame - frames[low - 1] <= frames[low] - frame) low--;
    const off = Math.abs(frames[low] - frame);
    if (!best || off < best.off) best = { sheet, at: low, off };
  }
  return best;
}

// The sheet's image, decoded; `then` is called once it is there.
function imageOf(sheet, then) {
  let image = sheetImages.get(sheet.source);
  if (image) sheetImages.delete(sheet.source);
  else {
    image = new Image();
    image.src = sheet.source;
  }
  sheetImages.set(sheet.source, image);
  if (sheetImages.size > KEPT_SHEETS) sheetImages.delete(sheetImages.keys().next().value);
  if (!image.complete || !image.naturalWidth) image.addEventListener("load", then, { once: true });
  return image;
}

function drawPictures(place, frame, redraw) {
  const one = demonstrations[place];
  cameraViews.forEach((view, camera) => {
    const found = nearestPicture(one.sheets[camera], frame);
    view.canvas.hidden = !found;
    if (!found) {
      view.caption.textContent = `${view.name}: no picture`;
      return;
    }
    const { sheet, at } = found;
    const image = imageOf(sheet, redraw);
    if (!image.complete || !image.naturalWidth) return; // the picture before stays until this one is there
    if (view.canvas.width !== sheet.width) view.canvas.width = sheet.width;
    if (view.canvas.height !== sheet.height) view.canvas.height = sheet.height;
    const column = at % sheet.columns;
    const row = Math.floor(at / sheet.columns);
    const { width, height } = sheet;
    view.canvas
      .getContext("2d")
      .drawImage(image, column * width, row * height, width, height, 0, 0, width, height);
    const shown = sheet.frames[at];
    view.caption.textContent = `${view.name}, frame ${shown}`;
    view.canvas.setAttribute("aria-label", `${view.name}, demonstration ${one.episode}, frame ${shown}`);
  });
}
