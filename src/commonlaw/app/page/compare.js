// Comparisons: of the candidate that is shown with the law of another search in the same table, and of groups of objects.
import { $, ask, element, fill, state, trying } from "./basics.js";
import { showCurves } from "./curves.js";

/** Offer the laws of other searches; a comparison with another candidate is none any more. */
export async function offerRivals() {
  state.rival = null;
  showComparison(null);
  await trying("compare_failed", async () => {
    const laws = (await ask("searches")).filter(each => each.table === state.table && each.search !== state.search);
    $("compare").hidden = !laws.length;
    $("rival").replaceChildren(element("option", "choose a law", { value: "" }), ...laws.map(({ search, text }, i) => element("option", `${i + 1}: ${text}`, { value: search })));
  });
}

export async function compare() {
  const rival = $("rival").value;
  state.rival = null;
  showComparison(null);
  $("comparing").textContent = rival ? "Comparing ..." : "";
  await trying("compare_failed", async () => {
    if (!rival) return;
    const { search, at } = state, found = await ask(`searches/${search}/comparison`, "POST", { search: rival, candidate: at });
    if (state.search !== search || state.at !== at || $("rival").value !== rival) return;
    state.rival = found;
    showComparison(found);
  });
  $("comparing").textContent = "";
  showCurves();
}

/** Offer the properties by which objects can be compared. */
export function offerGroups() {
  const names = Object.keys(state.found.groups), before = $("groups_by").value;
  $("groups_part").hidden = !names.length;
  $("groups_by").replaceChildren(...names.map(name => element("option", name, { value: name })));
  if (names.includes(before)) $("groups_by").value = before;
  else offerReferences();
  compareGroups();
}

export function offerReferences() {
  $("groups_reference").replaceChildren(...(state.found.groups[$("groups_by").value] ?? []).map((value, i) => element("option", value, { value: i })));
}

let asked = null;

export async function compareGroups() {
  if ($("groups_part").hidden || !$("groups_part").open) return;
  const { search } = state, now = asked = { by: $("groups_by").value, reference: Number($("groups_reference").value), candidate: state.at };
  await trying("groups_failed", async () => {
    const { head, rows } = await ask(`searches/${search}/groups`, "POST", now);
    if (state.search === search && asked === now) fill($("groups"), head, rows);
  });
}

function showComparison(found) {
  $("comparison").hidden = !found;
  $("comparison_text").textContent = found ? found.problem || "2 log B: evidence against a law relative to the other; above 10 is very strong (Kass and Raftery 1995). Its curves are dashed." : "";
  if (!found) return;
  const { laws } = found, kinds = [...new Set(laws.flatMap(each => Object.keys(each.errors)))];
  const rows = [["Equations", ...laws.map(each => each.equations.join("; "))], ["Parameters of an object", ...laws.map(each => each.parameters)]];
  if (laws.every(each => each.evidence !== null)) rows.push(["2 log B", ...laws.map(each => Number(each.evidence.toPrecision(3)))]);
  const said = own => own ? Object.entries(own).map(([name, value]) => `${name} ${value}`).join(", ") : "";
  rows.push(...kinds.map(kind => [`RMS ${kind}`, ...laws.map(each => said(each.errors[kind]))]));
  fill($("comparison"), ["", "Law shown", "Compared law"], rows);
}
