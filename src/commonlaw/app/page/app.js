// The page: a table, a question, a law. All that a law needs is here once it was found; moving along candidates asks nobody.
import { draw } from "./plots.js";

const $ = id => document.getElementById(id);
const state = { table: null, search: null, preview: null, found: null, columns: {}, at: 0 };
const LIBRARIES = [
  ["poly:3", "products of up to three variables (usual)"],
  ["poly:2", "products of up to two variables"],
  ["poly:1", "the variables themselves"],
  ["terms:1,v,v*abs(v)", "forces that depend on speed", 2],
  ["poly:1 + fourier:1", "the variables, sines and cosines"],
];
const MOST_SHOWN = 3;

async function ask(path, method = "GET", body = undefined) {
  const answer = await fetch(path, { method, body: body instanceof Blob || body === undefined ? body : JSON.stringify(body) });
  const said = answer.headers.get("content-type")?.startsWith("application/json") ? await answer.json() : {};
  if (!answer.ok) throw new Error(said.error ?? `the server refused this (${answer.status}): start the app again`);
  return said;
}

function element(kind, text = "", attributes = {}) {
  const made = document.createElement(kind);
  made.textContent = text;
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
}

function fill(table, head, rows) {
  const line = (cells, kind) => { const row = element("tr"); row.append(...cells.map(each => element(kind, each ?? "", kind === "th" ? { scope: "col" } : {}))); return row; };
  table.tHead.replaceChildren(line(head, "th"));
  table.tBodies[0].replaceChildren(...rows.map(row => line(row, "td")));
}

function withUnit({ name, unit }) {
  return unit ? `${name} (${unit})` : name;
}

function remember() {
  const kept = Object.entries({ table: state.table, search: state.search }).filter(([, value]) => value);
  history.replaceState(null, "", `#${new URLSearchParams(kept)}`);
}

async function trying(place, work) {
  $(place).textContent = "";
  try {
    await work();
  } catch (error) {
    $(place).textContent = error.message;
  }
}

// 1. Measurements

async function openTable(made) {
  await trying("failure", async () => {
    const { table } = await made();
    Object.assign(state, { table, search: null, found: null, columns: {} });
    $("result").hidden = true;
    remember();
    await recognise();
  });
}

const openFile = file => openTable(() => ask(`tables?name=${encodeURIComponent(file.name)}`, "POST", file));

async function recognise() {
  state.preview = await ask("previews", "POST", { table: state.table, columns: state.columns });
  showPreview();
}

function showPreview() {
  const found = state.preview, roles = found.roles;
  $("table").hidden = false;
  $("problem").textContent = found.problem;
  $("ask").hidden = Boolean(found.problem);
  showColumns(found);
  if (found.problem) {
    $("counts").textContent = found.name;
    $("columns").open = true;
    return draw($("preview_plot"), [], {});
  }
  const plural = (count, word) => `${count} ${word}${count === 1 ? "" : "s"}`;
  $("counts").textContent = `${found.name}: ${plural(found.count, "trial")} of ${plural(found.objects.length, "object")}, ${plural(found.samples, "sample")}; states ${roles.states.join(", ")}`;
  $("odd").hidden = !found.odd.length;
  $("odd").firstElementChild.textContent = `What is odd (${found.odd.length})`;
  $("odd").lastElementChild.replaceChildren(...found.odd.map(each => element("li", each)));
  const curves = found.trials.flatMap((trial, i) => ({ t: trial.t, line: trial.states[0], points: trial.states[0], label: `${trial.object}, ${trial.name}`, color: i }));
  draw($("preview_plot"), curves, { x: withUnit({ name: roles.time, unit: found.units[roles.time] }), y: withUnit({ name: roles.states[0], unit: found.units[roles.states[0]] }), height: 220 });
  showLibraries();
  showHeld();
}

function showColumns({ columns, rows, roles }) {
  const table = $("columns").querySelector("table");
  fill(table, columns, rows);
  const choices = element("tr");
  for (const name of columns) {
    const cell = element("td"), choice = element("select", "", { "aria-label": `What ${name} is`, "data-column": name });
    for (const role of ["", "object", "trial", "time", "state", "input", "property"]) choice.append(element("option", role || "not used", { value: role }));
    choice.value = roleOf(name, roles ?? {});
    choice.addEventListener("change", setColumns);
    cell.append(choice);
    choices.append(cell);
  }
  table.tBodies[0].prepend(choices);
}

function roleOf(name, roles) {
  for (const role of ["object", "trial", "time"]) if (roles[role] === name) return role;
  if (roles.states?.includes(name)) return "state";
  if (roles.inputs?.includes(name)) return "input";
  return roles.properties?.includes(name) ? "property" : "";
}

async function setColumns() {
  const chosen = [...$("columns").querySelectorAll("select")].map(each => [each.dataset.column, each.value]);
  const all = role => chosen.filter(([, value]) => value === role).map(([name]) => name);
  state.columns = { object: all("object")[0] ?? null, trial: all("trial")[0] ?? null, time: all("time")[0] ?? null, states: all("state"), inputs: all("input"), properties: all("property") };
  await trying("failure", recognise);
}

// 2. Question

function showLibraries() {
  const order = Number($("order").value), one = state.preview.roles.states.length === 1;
  const fitting = LIBRARIES.filter(([, , only]) => !only || (only === order && one));
  $("library").replaceChildren(...fitting.map(([value, text]) => element("option", text, { value })));
}

function showHeld() {
  const kind = $("hold_out").value, names = kind === "object" ? state.preview.objects : kind === "trial" ? state.preview.labels : [];
  $("held").hidden = !names.length;
  $("after").hidden = kind !== "after";
  $("held").replaceChildren(...names.map(name => element("option", name, { value: name })));
}

function known() {
  const pairs = $("known").value.split(",").map(each => each.trim()).filter(Boolean).map(each => each.split("="));
  const wrong = pairs.find(([name, value]) => !name || value === undefined || !Number.isFinite(Number(value)));
  if (wrong) throw new Error(`known coefficients are written like 1=-9.81, and not like ${wrong.join("=")}`);
  return Object.fromEntries(pairs.map(([name, value]) => [name.trim(), Number(value)]));
}

function question(law = null) {
  const kind = $("hold_out").value;
  return {
    table: state.table, columns: state.columns, order: Number($("order").value), library: $("own_library").value.trim() || $("library").value,
    hold_out: { kind, value: kind === "after" ? $("after").value : $("held").value }, known: known(), explain: $("explain").checked, law,
  };
}

async function start(law = null) {
  await trying("failed", async () => {
    state.asked = question(law);
    const { search } = await ask("searches", "POST", state.asked);
    state.search = search;
    remember();
    await follow();
  });
}

async function follow() {
  const search = state.search;
  $("going").hidden = $("cancel").hidden = false;
  $("start").disabled = true;
  try {
    for (;;) {
      const now = await ask(`searches/${search}`);
      if (state.search !== search) return;
      $("stage").textContent = now.running ? `${now.stages.at(-1)} (${Math.round(now.seconds)} s)` : "";
      if (!now.running) {
        if (now.failure) throw new Error(now.failure);
        return show(now.found);
      }
      await new Promise(done => setTimeout(done, 400));
    }
  } finally {
    $("going").hidden = $("cancel").hidden = true;
    $("start").disabled = false;
  }
}

// 3. The law

function show(found) {
  state.found = found;
  $("result").hidden = false;
  $("verdict").textContent = found.verdict.join(" ");
  $("slider").max = found.candidates.length - 1;
  $("slider").disabled = found.candidates.length < 2;
  $("state").replaceChildren(...found.states.map((each, i) => element("option", each.name, { value: i })));
  showTrialChoices(found);
  showOwn(found);
  showFiles();
  fill($("history"), ["stage", "choice", "reason"], found.history);
  move(found.candidates.findIndex(each => each.chosen));
  $("law_title").scrollIntoView();
}

function move(index) {
  const began = performance.now(), found = state.found, candidate = found.candidates[index];
  state.at = index;
  $("slider").value = index;
  const parts = [`${candidate.size} term${candidate.size === 1 ? "" : "s"}${candidate.chosen ? ", chosen" : ""}`];
  if (candidate.evidence !== null) parts.push(`2 log B ${candidate.evidence.toPrecision(3)}`);
  if (candidate.score !== null) parts.push(`R² of forecasts ${candidate.score.toPrecision(4)}${found.held_out ? " (held out)" : ""}`);
  $("which").textContent = parts.join("; ");
  $("slider").setAttribute("aria-valuetext", parts.join("; "));
  // MathML of the server's own making, in which names are text
  if (candidate.formula) $("formula").innerHTML = candidate.formula;
  else $("formula").textContent = candidate.text.join("\n");
  showTerms(found, candidate);
  fill($("coefficients"), candidate.table.head, candidate.table.rows);
  showCurves();
  state.moved = performance.now() - began;
  document.body.dataset.moved = state.moved.toFixed(1);
}

function showTerms(found, candidate) {
  $("terms").replaceChildren(...candidate.terms.map(({ left, in: own }, j) => {
    const line = element("div"), all = found.terms.filter(term => found.candidates.some(each => each.terms[j].in.includes(term)));
    line.append(element("span", left));
    for (const term of all) {
      const button = element("button", term, { "aria-pressed": String(own.includes(term)), "aria-label": `${term} in ${left}` });
      const target = nearest(found, j, term, !own.includes(term));
      button.disabled = target < 0;
      button.addEventListener("click", () => move(target));
      line.append(button);
    }
    return line;
  }));
}

/** The nearest candidate with a term, or without it. */
function nearest(found, j, term, wanted) {
  const fitting = found.candidates.map((each, i) => i).filter(i => found.candidates[i].terms[j].in.includes(term) === wanted);
  return fitting.sort((a, b) => Math.abs(a - state.at) - Math.abs(b - state.at))[0] ?? -1;
}

// 4. Curves

function showTrialChoices(found) {
  $("trials").replaceChildren(...found.trials.map((each, i) => {
    const label = element("label"), box = element("input", "", { type: "checkbox", value: i });
    box.checked = i < MOST_SHOWN;
    label.append(box, ` ${each.object}, ${each.name}`);
    return label;
  }));
}

function showCurves() {
  const found = state.found, candidate = found.candidates[state.at], j = Number($("state").value);
  const chosen = [...$("trials").querySelectorAll("input:checked")].map(each => Number(each.value)).filter(i => candidate.curves[i]);
  const curves = chosen.map(i => {
    const [points, line, low, high] = candidate.curves[i].states[j];
    return { t: candidate.curves[i].t, points, line, low, high, label: `${found.trials[i].object}, ${found.trials[i].name}`, color: i };
  });
  const x = withUnit(found.time), name = withUnit(found.states[j]);
  draw($("forecast_plot"), curves, { x, y: name });
  $("bands").hidden = curves.some(each => each.low) || !curves.length;
  const errors = curves.map(({ t, points, line, label, color }) => {
    const kept = t.map((_, k) => k).filter(k => points[k] !== null && line[k] !== null);
    return { t: kept.map(k => t[k]), points: kept.map(k => line[k] - points[k]), label, color };
  });
  draw($("error_plot"), errors, { x, y: "error", height: 180 });
}

// 5. A forecast of one's own

function showOwn(found) {
  $("own").hidden = found.inputs.length > 0;
  const unseen = found.follows.length ? [element("option", "one of your own", { value: "" })] : [];
  $("own_object").replaceChildren(...found.objects.map(name => element("option", name, { value: name })), ...unseen);
  $("own_properties").replaceChildren(...found.follows.flatMap((name, j) => [
    element("label", name, { for: `property_${j}` }), " ", element("input", "", { id: `property_${j}`, type: "number", step: "any", value: 1, "data-name": name }), " ",
  ]));
  const names = [...found.states.map(each => each.name), ...found.rates], first = found.candidates.find(each => each.chosen).curves[0];
  $("starts").replaceChildren(...names.flatMap((name, j) => {
    const value = first?.states[j]?.[1]?.find(each => each !== null) ?? 0;
    return [element("label", name, { for: `start_${j}` }), " ", element("input", "", { id: `start_${j}`, type: "number", step: "any", value }), " "];
  }));
  $("duration").value = first ? first.t.at(-1) - first.t[0] || 1 : 1;
  for (const input of $("own").querySelectorAll("#starts input, #own_properties input")) input.addEventListener("change", forecastOwn);
  forecastOwn();
}

async function forecastOwn() {
  if (state.found.inputs.length) return;
  await trying("own_failed", async () => {
    const start = [...$("starts").querySelectorAll("input")].map(each => Number(each.value));
    const object = $("own_object").value;
    $("own_properties").hidden = Boolean(object);
    const properties = object ? {} : Object.fromEntries([...$("own_properties").querySelectorAll("input")].map(each => [each.dataset.name, Number(each.value)]));
    const asked = { candidate: state.at, object: object || "your own", start, duration: Number($("duration").value), properties };
    const { t, states, outcome } = await ask(`searches/${state.search}/forecasts`, "POST", asked);
    $("own_failed").textContent = outcome;
    const curves = states.map((line, j) => ({ t, line, label: withUnit(state.found.states[j]), color: j }));
    draw($("own_plot"), curves, { x: withUnit(state.found.time), y: "", height: 220, dragged });
  });
}

let waiting = false;

/** The start of a state was dragged to a value; forecasts follow as fast as they come. */
async function dragged(j, value) {
  $(`start_${j}`).value = Number(value.toPrecision(4));
  if (waiting) return;
  waiting = true;
  await forecastOwn();
  waiting = false;
}

// 6. Take away

function showFiles() {
  const files = { "report.html": "the report, one page with everything", "law.json": "the law, to open again", "coefficients.csv": "the coefficients", "forecasts.csv": "measured and forecast states, with bands", "law.svg": "the law and its forecasts as a figure", "law.tex": "the equations in LaTeX", "law.py": "a Python script that finds it again" };
  $("files").replaceChildren(...Object.entries(files).map(([name, text]) => {
    const line = element("li");
    const link = element("a", name, { href: `searches/${state.search}/${name}`, download: name });
    link.addEventListener("click", take);
    line.append(link, `: ${text}`);
    return line;
  }));
  $("command").textContent = command();
}

/** Save a file once it is made, and say how far that is: a report takes a while. */
async function take(event) {
  const { href, download } = event.currentTarget;
  event.preventDefault();
  $("taking").textContent = `Making ${download} ...`;
  try {
    const answer = await fetch(href);
    if (!answer.ok) throw new Error((await answer.json()).error);
    const made = URL.createObjectURL(await answer.blob());
    element("a", "", { href: made, download }).click();
    setTimeout(() => URL.revokeObjectURL(made), 60000);
    $("taking").textContent = `${download} is in your downloads.`;
  } catch (error) {
    $("taking").textContent = `${download} could not be made: ${error.message}`;
  }
}

function command() {
  const quoted = text => /^[\w.:=,+-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`;
  const { preview, asked } = state, said = ["commonlaw", "discover", preview.name];
  if (!asked) return "";
  const columns = asked.columns;
  for (const role of ["object", "trial", "time"]) if (columns[role]) said.push(`--${role}`, columns[role]);
  for (const [option, role] of [["--state", "states"], ["--input", "inputs"], ["--property", "properties"]]) for (const name of columns[role] ?? []) said.push(option, name);
  said.push("--order", String(asked.order), "--library", asked.library);
  for (const [name, value] of Object.entries(asked.known)) said.push("--known", `${name}=${value}`);
  const { kind, value } = asked.hold_out;
  if (kind === "after") said.push("--learn-until", value);
  else if (kind !== "nothing") said.push("--hold-out", `${preview.roles[kind]}=${value}`);
  if (asked.explain) said.push("--explain");
  return said.map(quoted).join(" ");
}

// Events

const drop = $("drop");
for (const name of ["dragover", "dragleave", "drop"]) {
  drop.addEventListener(name, event => { event.preventDefault(); drop.classList.toggle("over", name === "dragover"); });
}
drop.addEventListener("drop", event => event.dataTransfer.files[0] && openFile(event.dataTransfer.files[0]));
$("file").addEventListener("change", () => $("file").files[0] && openFile($("file").files[0]));
$("sample").addEventListener("change", () => $("sample").value && openTable(() => ask("datasets", "POST", { name: $("sample").value })));
$("order").addEventListener("change", showLibraries);
$("hold_out").addEventListener("change", showHeld);
$("start").addEventListener("click", () => start());
$("cancel").addEventListener("click", () => trying("failed", () => ask(`searches/${state.search}`, "DELETE")));
$("slider").addEventListener("input", () => move(Number($("slider").value)));
$("slider").addEventListener("change", forecastOwn);
$("state").addEventListener("change", showCurves);
$("trials").addEventListener("change", showCurves);
for (const [id, checked] of [["none", false], ["all", true]]) {
  $(id).addEventListener("click", () => { for (const box of $("trials").querySelectorAll("input")) box.checked = checked; showCurves(); });
}
for (const id of ["own_object", "duration"]) $(id).addEventListener("change", forecastOwn);
$("saved").addEventListener("change", async () => $("saved").files[0] && start(await $("saved").files[0].text()));

// Coming back after a reload, or with a table that the command named
const kept = new URLSearchParams(location.hash.slice(1));
await trying("failure", async () => {
  state.table = kept.get("table") ?? (await ask("first")).table;
  if (!state.table) return;
  await recognise();
  state.search = kept.get("search");
  if (state.search) await trying("failed", follow);
});
