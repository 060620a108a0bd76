// 2. Question: which law is looked for, and the search for it.
import { $, ask, element, follow, remember, state, trying } from "./basics.js";
import { showMeasured } from "./curves.js";
import { restoreEquations } from "./equations.js";
import { saveAgain } from "./sessions.js";
import { followFit, settle, show } from "./law.js";

const LIBRARIES = [
  ["auto", "automatic: polynomials, then richer terms"],
  ["poly:3", "polynomials up to degree 3: x, x², x² y"],
  ["poly:2", "polynomials up to degree 2: x, x², x y"],
  ["poly:1", "linear terms: x, y"],
  ["terms:1,v,v*abs(v)", "drag forces: v, v |v|", "2"],
  ["poly:1 + fourier:1", "linear terms with sines and cosines"],
  ["ratio(poly:2, poly:2)", "ratios of polynomials: x/(K + x)"],
];

export function showLibraries() {
  const order = $("order").value, one = state.preview.roles.states.length === 1;
  const fitting = LIBRARIES.filter(([, , only]) => !only || (only === order && one));
  $("library").replaceChildren(...fitting.map(([value, text]) => element("option", text, { value })));
}

export function showHeld() {
  const kind = $("hold_out").value, names = kind === "object" ? state.preview.objects : kind === "trial" ? state.preview.labels : [];
  $("held").hidden = !names.length;
  $("after").hidden = kind !== "after";
  $("held").replaceChildren(...names.map(name => element("option", name, { value: name })));
}

/** Make a field for each setting of the fit, as the server describes them. */
export async function makeSettings() {
  state.settings = await ask("settings");
  $("settings").append(...state.settings.flatMap(({ name, label, text, choices, default: usual, example }) => {
    const id = `setting_${name}`, said = { id, "aria-describedby": `${id}_text` }, options = Object.entries(choices);
    const field = options.length ? element("select", "", said) : element("input", "", { ...said, placeholder: usual || example });
    field.append(...options.map(([value, meaning]) => element("option", meaning, { value })));
    if (options.length) field.value = usual;
    const shown = element("span");
    shown.append(field, " ", element("span", text, { id: `${id}_text`, class: "soft" }));
    return [element("label", label, { for: id }), shown];
  }));
}

/** The settings that differ from their defaults, each with its texts: commas stand between several. */
function settings() {
  const given = state.settings.map(({ name, default: usual }) => [name, $(`setting_${name}`).value.trim(), usual]);
  return Object.fromEntries(given.filter(([, text, usual]) => text && text !== usual).map(([name, text]) => [name, text.split(",").map(each => each.trim())]));
}

function known() {
  const pairs = $("known").value.split(",").map(each => each.trim()).filter(Boolean).map(each => each.split("="));
  const wrong = pairs.find(([name, value]) => !name || value === undefined || !Number.isFinite(Number(value)));
  if (wrong) throw new Error(`write fixed coefficients as 1=-9.81, not ${wrong.join("=")}`);
  return Object.fromEntries(pairs.map(([name, value]) => [name.trim(), Number(value)]));
}

function question(more) {
  const kind = $("hold_out").value, order = $("order").value;
  return {
    table: state.table, columns: state.columns, order: order === "auto" ? order : Number(order), library: $("own_library").value.trim() || $("library").value,
    hold_out: { kind, value: kind === "after" ? $("after").value : $("held").value }, known: known(), explain: $("explain").checked, time_limit: $("time_limit").value === "" ? null : Number($("time_limit").value), settings: settings(), ...more,
  };
}

/** Put what was asked before into the form. */
export function showQuestion({ order, library, hold_out, known, explain, time_limit, settings, equations }) {
  if (equations) restoreEquations(equations);
  $("order").value = order;
  showLibraries();
  const offered = [...$("library").options].some(each => each.value === library);
  if (offered) $("library").value = library;
  $("own_library").value = offered ? "" : library;
  $("hold_out").value = hold_out.kind;
  showHeld();
  $(hold_out.kind === "after" ? "after" : "held").value = hold_out.value;
  $("known").value = Object.entries(known).map(pair => pair.join("=")).join(", ");
  $("explain").checked = explain;
  $("time_limit").value = time_limit ?? "";
  for (const { name, choices, default: usual } of state.settings) $(`setting_${name}`).value = settings[name]?.join(", ") ?? (Object.keys(choices).length ? usual : "");
}

/** Begin a search; `more` has equations to fit, or a saved law to show. */
export async function start(more = {}) {
  await trying("failed", async () => {
    state.search = (await ask("searches", "POST", question(more))).search;
    remember();
    await showSearch();
  });
}

/** Wait for the search, and show what it finds: the law, and later its rivals. */
export async function showSearch() {
  const search = state.search, path = `searches/${search}`, left = () => state.search !== search;
  $("start").disabled = state.busy = true;
  state.found = null;
  showMeasured();
  try {
    const told = await follow(path, "going", left, async () => {
      const made = await ask(`${path}/found`);
      if (!left()) show(made);
    });
    if (told) await saveAgain();
    if (told?.fitting) trying("terms_failed", followFit);
  } finally {
    if (state.search === search || !state.search) $("start").disabled = state.busy = false;
    settle();
  }
}
