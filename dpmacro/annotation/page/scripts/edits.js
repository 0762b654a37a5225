// What a person may change, as functions from one state to the next. A state is never changed in place:
//   stages    of each its name, its colour's number and why it had its first name
//   renamed   of every stage in the data, its number now
//   segments  of every demonstration, [{start, label}], ascending, the first at 0
//   held      the places of demonstrations that a file of corrections lists, however they are cut

const firstState = {
  stages: data.names.map((name, k) => ({ name, colour: k, reason: data.reasons[k] || "" })),
  renamed: data.names.map((_, k) => k),
  segments: demonstrations.map((one) => one.segments),
  held: new Set(),
};

// Neighbours of one stage become one segment.
function joined(segments) {
  return segments.filter((one, k) => k === 0 || one.label !== segments[k - 1].label);
}

function withSegments(state, place, segments) {
  const all = state.segments.slice();
  all[place] = segments;
  return { ...state, segments: all };
}

// A cut before `frame`; both parts keep their stage until one gets another. Null where there is one already.
function withCut(segments, frame) {
  const at = runAt(segments, frame);
  if (segments[at].start === frame) return null;
  return [...segments.slice(0, at + 1), { start: frame, label: segments[at].label }, ...segments.slice(at + 1)];
}

// Without the cut before segment `cut`: the stage before it goes on.
function withoutCut(segments, cut) {
  return joined(segments.filter((_, k) => k !== cut));
}

// Where a cut may stand so that both its segments keep a frame.
function clampedCut(segments, cut, frame, frames) {
  return Math.max(segments[cut - 1].start + 1, Math.min(endOf(segments, cut, frames) - 1, frame));
}

function withCutMoved(segments, cut, frame) {
  return segments.map((one, k) => (k === cut ? { ...one, start: frame } : one));
}

function withLabel(segments, at, label) {
  return joined(segments.map((one, k) => (k === at ? { ...one, label } : one)));
}

function withName(state, stage, name) {
  return { ...state, stages: state.stages.map((one, k) => (k === stage ? { ...one, name } : one)) };
}

function withStage(state) {
  const used = new Set(state.stages.map((one) => one.colour));
  const names = new Set(state.stages.map((one) => one.name));
  let colour = 0;
  while (used.has(colour)) colour++;
  let number = state.stages.length + 1;
  while (names.has(`stage ${number}`)) number++;
  return { ...state, stages: [...state.stages, { name: `stage ${number}`, colour, reason: "" }] };
}

// Stage `from` becomes stage `into` in all demonstrations; those after `from` move up by one.
function withMerged(state, from, into) {
  const now = (label) => {
    const kept = label === from ? into : label;
    return kept > from ? kept - 1 : kept;
  };
  return {
    ...state,
    stages: state.stages.filter((_, k) => k !== from),
    renamed: state.renamed.map(now),
    segments: state.segments.map((own) => joined(own.map((one) => ({ ...one, label: now(one.label) })))),
  };
}

// A demonstration's segments as they were found, their stages renamed and merged like all others'.
function asFound(state, place) {
  return joined(demonstrations[place].segments.map((one) => ({ ...one, label: state.renamed[one.label] })));
}

function withFound(state, place) {
  const held = new Set(state.held);
  held.delete(place);
  return { ...withSegments(state, place, asFound(state, place)), held };
}

function isIdentity(renamed) {
  return renamed.every((label, k) => label === k);
}

// Whether a person corrected a demonstration: it is in a file of corrections, or was changed otherwise than by
// names and mergers, which concern all alike.
function isEdited(state, place) {
  if (state.held.has(place)) return true;
  if (state.segments[place] === demonstrations[place].segments) return false;
  const was = asFound(state, place);
  const is = joined(state.segments[place]);
  return was.length !== is.length || was.some((one, k) => one.start !== is[k].start || one.label !== is[k].label);
}

const editedIn = new WeakMap(); // state -> places, for a state is looked at often and never changes

function editedPlaces(state) {
  if (!editedIn.has(state)) {
    editedIn.set(state, demonstrations.map((one) => one.place).filter((place) => isEdited(state, place)));
  }
  return editedIn.get(state);
}

function isChanged(state) {
  const names = state.stages.map((one) => one.name);
  return (
    names.length !== data.names.length ||
    names.some((name, k) => name !== data.names[k]) ||
    !isIdentity(state.renamed) ||
    editedPlaces(state).length > 0
  );
}

// What is saved: only the demonstrations that a person changed; `renamed` says what became of all stages.
function corrections(state) {
  const episodes = editedPlaces(state).map((place) => {
    const { episode, frames } = demonstrations[place];
    const own = joined(state.segments[place]);
    const segments = own.map((one, k) => ({ start: one.start, end: endOf(own, k, frames), label: one.label }));
    return { episode, frames, segments };
  });
  return {
    format: data.format,
    dataset: data.dataset,
    fps: data.fps,
    names: state.stages.map((one) => one.name),
    renamed: state.renamed.map((now, old) => [old, now]),
    episodes,
  };
}

// The state that a saved file describes. Throws an Error with one line where it is not of this page.
function stateFrom(found) {
  const must = (holds, text) => {
    if (!holds) throw new Error(text);
  };
  const within = (value, end) => Number.isInteger(value) && value >= 0 && value < end;
  must(found && found.format === data.format, `it is not of the format "${data.format}"`);
  must(found.dataset === data.dataset, `it is of the dataset ${found.dataset}, this page of ${data.dataset}`);
  const { names, renamed, episodes } = found;
  const isName = (name) => typeof name === "string" && name.trim() !== "";
  must(Array.isArray(names) && names.length > 0 && names.every(isName), "it has no names of stages");
  must(new Set(names).size === names.length, "two of its stages have one name");
  const pairs = new Map(Array.isArray(renamed) ? renamed : []);
  const now = data.names.map((_, old) => pairs.get(old));
  must(pairs.size === data.names.length, `it is of ${pairs.size} stages, this page of ${data.names.length}`);
  must(now.every((label) => within(label, names.length)), "its stages are not those of this page");
  const stages = names.map((name, k) => {
    const old = now.indexOf(k);
    return { name, colour: old < 0 ? data.names.length + k : old, reason: (old >= 0 && data.reasons[old]) || "" };
  });
  const segments = demonstrations.map((one) =>
    joined(one.segments.map(({ start, label }) => ({ start, label: now[label] }))),
  );
  must(Array.isArray(episodes), "it has no list of episodes");
  const held = new Set();
  for (const { episode, frames, segments: own } of episodes) {
    const one = demonstrations.find((other) => other.episode === episode);
    must(one && one.frames === frames, `its episode ${episode} is not of this page`);
    const whole =
      Array.isArray(own) && own.length > 0 && own[0].start === 0 && own[own.length - 1].end === frames &&
      own.every((part, k) => part.start < part.end && (!k || part.start === own[k - 1].end)) &&
      own.every((part) => within(part.start, frames) && within(part.label, names.length));
    must(whole, `its episode ${episode} is not covered by segments`);
    held.add(one.place);
    segments[one.place] = joined(own.map(({ start, label }) => ({ start, label })));
  }
  return { stages, renamed: now, segments, held };
}

// What the page opens with: corrections that were made earlier are in it, and are saved with the new ones.
const opened = data.corrections ? stateFrom(data.corrections) : firstState;

function isEarlier(state, place) {
  return opened.held.has(place) && state.held.has(place) && state.segments[place] === opened.segments[place];
}

// Undo and redo. Changes of one `gesture` (a cut held and moved key by key) are undone together.
// The first step back from corrections made earlier leaves all of them out.
const history = { past: opened === firstState ? [] : [firstState], state: opened, future: [], gesture: null };

function remember(state, gesture = null) {
  if (gesture === null || gesture !== history.gesture) history.past.push(history.state);
  history.gesture = gesture;
  history.state = state;
  history.future = [];
}

function stepBack() {
  if (!history.past.length) return false;
  history.future.push(history.state);
  history.state = history.past.pop();
  history.gesture = null;
  return true;
}

function stepForward() {
  if (!history.future.length) return false;
  history.past.push(history.state);
  history.state = history.future.pop();
  history.gesture = null;
  return true;
}
