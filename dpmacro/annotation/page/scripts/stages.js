// The stages with their colours and keys; their names are text fields, and two can be merged.

const stageList = document.getElementById("stages");
const merge = document.getElementById("merge");
let stagesShown = null; // those that the list was made for

function button(text, label, act) {
  const one = document.createElement("button");
  one.type = "button";
  one.textContent = text;
  if (label) one.setAttribute("aria-label", label);
  one.addEventListener("click", act);
  return one;
}

function stageItem(stage, k) {
  const item = document.createElement("li");
  const swatch = button(k < 9 ? String(k + 1) : "", `Give the part under the cursor stage ${k + 1}`, () => assign(k));
  swatch.className = "swatch";
  swatch.style.backgroundColor = colourOf(stage);
  swatch.style.color = inkOn(colourOf(stage));
  const name = document.createElement("input");
  name.value = stage.name;
  name.size = Math.max(8, Math.min(24, stage.name.length + 1));
  name.autocomplete = "off";
  name.spellcheck = false;
  name.setAttribute("aria-label", `Name of stage ${k + 1}`);
  name.title = stage.reason;
  name.addEventListener("change", () => rename(k, name));
  name.addEventListener("keydown", (event) => {
    if (event.key === "Escape") name.value = stage.name;
    if (event.key === "Enter" || event.key === "Escape") strip.focus();
  });
  const share = document.createElement("span");
  share.className = "faint share";
  item.append(swatch, name, share);
  if (history.state.stages.length > 1) {
    item.append(button("Merge…", `Merge ${stage.name} into another stage`, () => askMerge(k)));
  }
  return item;
}

function rename(stage, field) {
  const name = field.value.trim();
  const { stages } = history.state;
  const other = stages.findIndex((one, k) => k !== stage && one.name === name);
  if (!name || other >= 0) {
    field.value = stages[stage].name;
    say(name ? `Stage ${other + 1} is called ${name} already: merge the two instead.` : "A stage needs a name.");
  } else if (name !== stages[stage].name) {
    change(withName(history.state, stage, name), `Stage ${stage + 1} is called ${name} now.`);
  } else field.value = name;
}

function askMerge(stage) {
  letGo();
  const { stages } = history.state;
  document.getElementById("merge-heading").textContent = `Merge ${stages[stage].name}`;
  const choice = document.getElementById("merge-into");
  choice.replaceChildren(
    ...stages.map((one, k) => new Option(`${k + 1} ${one.name}`, k)).filter((_, k) => k !== stage),
  );
  merge.dataset.stage = stage;
  merge.showModal();
  choice.focus();
}

// At "submit", not at the dialog's "close": that comes later, and a save could come between.
merge.addEventListener("submit", (event) => {
  if (event.submitter?.value !== "merge") return;
  const from = Number(merge.dataset.stage);
  const into = Number(document.getElementById("merge-into").value);
  const { stages } = history.state;
  change(
    withMerged(history.state, from, into),
    `${stages[from].name} is part of ${stages[into].name} now, in every demonstration.`,
  );
});

// Frames of every stage, in all demonstrations.
function stageFrames(state) {
  const counts = state.stages.map(() => 0);
  state.segments.forEach((own, place) => {
    own.forEach((one, k) => {
      counts[one.label] += endOf(own, k, demonstrations[place].frames) - one.start;
    });
  });
  return counts;
}

function drawStageList() {
  const { state } = history;
  if (stagesShown === state) return;
  if (!stagesShown || stagesShown.stages !== state.stages) {
    const items = state.stages.map(stageItem);
    const last = document.createElement("li");
    last.append(
      button("Add stage", "", () => {
        change(withStage(history.state), `Stage ${history.state.stages.length + 1} added: give it a name.`);
        drawNow();
        const fields = stageList.querySelectorAll("input");
        fields[fields.length - 1].select();
      }),
    );
    // The element in focus is made anew like all others: the one in its place gets the focus.
    const inFocus = [...stageList.querySelectorAll("button, input")].indexOf(document.activeElement);
    stageList.replaceChildren(...items, last);
    const elements = stageList.querySelectorAll("button, input");
    if (inFocus >= 0) elements[Math.min(inFocus, elements.length - 1)].focus();
  }
  const total = lengths.reduce((a, b) => a + b, 0);
  const shares = stageFrames(state).map((count) => `${((100 * count) / total).toFixed(0)}%`);
  stageList.querySelectorAll(".share").forEach((span, k) => {
    span.textContent = shares[k];
  });
  stagesShown = state;
}
