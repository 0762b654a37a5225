// What keys and buttons do to the cuts of the demonstration at hand.

function changeSegments(segments, message, gesture = null) {
  change(withSegments(history.state, ui.place, segments), message, gesture);
}

function change(state, message, gesture = null) {
  if (!gesture) letGo();
  remember(state, gesture);
  say(message);
  draw();
}

// The cut at the cursor or, where there is none, the nearest; 0 where the demonstration has no cut.
function nearestCut(segments, frame) {
  let best = 0;
  for (let k = 1; k < segments.length; k++) {
    if (!best || Math.abs(segments[k].start - frame) < Math.abs(segments[best].start - frame)) best = k;
  }
  return best;
}

function stepToCut(way) {
  letGo();
  const starts = currentSegments().slice(1).map((one) => one.start);
  const next = way > 0 ? starts.find((one) => one > ui.frame) : starts.reverse().find((one) => one < ui.frame);
  if (next === undefined) say(way > 0 ? "No cut after the cursor." : "No cut before the cursor.");
  else {
    setFrame(next);
    say(`Cut before frame ${next}.`);
  }
}

function addCut() {
  letGo();
  const segments = ui.frame > 0 ? withCut(currentSegments(), ui.frame) : null;
  if (!segments) say(`There is a cut before frame ${ui.frame} already.`);
  else changeSegments(segments, `Cut added before frame ${ui.frame}. Keys 1 to 9 give the part its stage.`);
}

function deleteCut() {
  letGo();
  const segments = currentSegments();
  const cut = nearestCut(segments, ui.frame);
  if (!cut) say("This demonstration has no cut.");
  else changeSegments(withoutCut(segments, cut), `Cut before frame ${segments[cut].start} deleted.`);
}

function takeBack() {
  letGo();
  const { episode } = current();
  if (!isEdited(history.state, ui.place)) return say(`Demonstration ${episode} is as it was found.`);
  return change(withFound(history.state, ui.place), `Demonstration ${episode} is as it was found again.`);
}

function assign(stage) {
  letGo();
  const { stages } = history.state;
  if (stage >= stages.length) return say(`There is no stage ${stage + 1}.`);
  const segments = currentSegments();
  const at = runAt(segments, ui.frame);
  if (segments[at].label === stage) return say(`It is ${stages[stage].name} already.`);
  const part = `Frames ${segments[at].start} to ${endOf(segments, at, current().frames) - 1}`;
  return changeSegments(withLabel(segments, at, stage), `${part} are ${stages[stage].name} now.`);
}

function toggleHold() {
  if (ui.held) {
    letGo();
    say("Cut let go.");
  } else {
    const segments = currentSegments();
    const cut = nearestCut(segments, ui.frame);
    if (!cut) return say("This demonstration has no cut.");
    ui.held = { cut, before: history.state, gesture: {} };
    setFrame(segments[cut].start);
    say(`Cut before frame ${ui.frame} held: the arrow keys move it, Enter lets it go, Escape puts it back.`);
  }
  return draw();
}

function letGo() {
  ui.held = null;
}

function putBack() {
  if (!ui.held) return;
  if (history.state !== ui.held.before) {
    stepBack();
    history.future.pop();
  }
  const { cut } = ui.held;
  letGo();
  setFrame(currentSegments()[cut].start);
  say("Cut put back.");
}

function moveHeld(by) {
  const segments = currentSegments();
  const { cut, gesture } = ui.held;
  const frame = clampedCut(segments, cut, segments[cut].start + by, current().frames);
  if (frame === segments[cut].start) return say("The segment ends here.");
  changeSegments(withCutMoved(segments, cut, frame), `Cut before frame ${frame}.`, gesture);
  return setFrame(frame);
}
