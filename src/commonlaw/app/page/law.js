// 3. The law: its formula and terms, the slider along its rivals, and laws of other terms.
import { $, ask, begin, element, fill, follow, plural, pretty, state, tell, trying } from "./basics.js";
import { endWritten, showCurves, showViews, showResult } from "./curves.js";
import { offerGroups, offerRivals } from "./compare.js";
import { offerFigures } from "./figures.js";
import { offerFound } from "./equations.js";
import { showNext } from "./next.js";
import { forecastOwn, showOwn } from "./own.js";
import { showFiles } from "./take.js";

/** Show what a search has found: a law first, and when its rivals come these too. */
export function show({ found, asked, written }) {
  if (state.found) return showMore(found);
  Object.assign(state, { found, asked: { ...asked, written }, written: null });
  showResult(true);
  $("verdict").textContent = found.verdict[0] ?? "";
  const more = [...found.verdict.slice(1), ...found.failures];
  $("limits").hidden = !more.length;
  $("limits").replaceChildren($("limits").firstElementChild, ...more.map(each => element("p", each)));
  const second = found.states.filter((_, j) => found.orders[j] === 2);
  const rates = found.rates.map(({ name }, i) => `${name} is the rate of ${second[i].name}`);
  $("terms_text").textContent = `Click a term to add or remove it${rates.length ? `; ${rates.join(", ")}` : ""}:`;
  $("evidence_text").hidden = found.candidates[0].evidence === null;
  showViews(found);
  showOwn(found);
  showNext();
  $("outcomes").replaceChildren(...found.outcomes.map(each => tell(element("li"), each)));
  fill($("history"), ["stage", "choice", "reason"], found.history);
  showCandidates();
  move(0);
  settle();
  $("law_title").scrollIntoView();
}

/** Show more candidates, after those that there were. */
function showMore(found) {
  Object.assign(state.found, found);
  showCandidates();
  move(state.at);
}

/** Let terms be clicked when nothing is searched any more. */
export function settle() {
  $("waiting").hidden = !state.busy;
  if (state.found) press();
}

/** Put candidates in order along the slider, and their terms on buttons. */
function showCandidates() {
  const { candidates } = state.found, key = each => [each.size, -(each.evidence ?? 0), Number(each.chosen)];
  const before = (a, b) => a.map((each, i) => each - b[i]).find(Boolean) ?? 0;
  state.order = candidates.map((_, i) => i).sort((i, j) => before(key(candidates[i]), key(candidates[j])));
  $("slider").max = candidates.length - 1;
  for (const each of [$("slider"), ...$("slider").labels]) each.hidden = candidates.length < 2;
  showTerms();
}

export function move(index) {
  const began = performance.now(), found = state.found, candidate = found.candidates[index];
  Object.assign(state, { at: index, wanted: candidate.terms });
  $("slider").value = state.order.indexOf(index);
  $("other").hidden = candidate.chosen;
  const parts = [`${plural(candidate.size, "term")}${candidate.chosen ? ", chosen" : ""}${candidate.own ? ", your choice" : ""}`];
  if (candidate.evidence !== null) parts.push(`${probable(candidate.evidence)} (2 log B ${Number(candidate.evidence.toPrecision(3))})`);
  found.views.forEach((view, i) => {
    parts.push(candidate.views[i].score.replace("R^2", "R²") || `${view.title}: cannot be computed for these trials`);
  });
  $("which").textContent = parts.join("; ");
  $("slider").setAttribute("aria-valuetext", parts.join("; "));
  $("formula").replaceChildren(...candidate.formula.length ? candidate.formula.map(equation) : candidate.text.map(each => element("div", each, { class: "equation" })));
  $("formula").append(...candidate.remarks.map(each => element("div", each, { class: "soft" })));
  press();
  $("coefficients").caption.textContent = candidate.caption;
  fill($("coefficients"), candidate.table.head, candidate.table.rows);
  $("quantities_part").hidden = !candidate.quantities.rows.length;
  fill($("quantities"), candidate.quantities.head, candidate.quantities.rows);
  endWritten();
  offerFound();
  offerRivals();
  offerGroups();
  offerFigures();
  showCurves();
  showFiles();
  clearTimeout(state.soon);
  state.soon = setTimeout(forecastOwn, 150);
  state.moved = performance.now() - began;
  document.body.dataset.moved = state.moved.toFixed(1);
}

/** An equation as parts between which a line may break; they are MathML of the server's own making, in which names are text. */
export function equation(parts) {
  const line = element("div", "", { class: "equation" });
  line.innerHTML = parts.join("<wbr>");
  return line;
}

/** How probable a candidate is relative to the best (Kass and Raftery 1995). */
function probable(evidence) {
  const words = [[0, "the most probable"], [2, "not distinguishable from the best"], [6, "positive evidence against it"], [10, "strong evidence against it"]];
  return words.find(([most]) => evidence <= most)?.[1] ?? "very strong evidence against it";
}

// Terms, taken in and out

function showTerms() {
  const { found } = state, { terms, candidates } = found, focused = document.activeElement.getAttribute("aria-label");
  $("terms").replaceChildren(...candidates[0].left.map((left, j) => {
    const line = element("div"), near = terms.filter(term => candidates.some(each => each.terms[j].includes(term)));
    const buttons = names => names.map(term => termButton(j, left, term)), others = terms.filter(each => !near.includes(each));
    line.append(element("span", `${left} (${found.orders[j] === 2 ? `acceleration of ${found.states[j].name}` : `rate of ${found.states[j].name}`})`), ...buttons(near));
    if (others.length && found.others) {
      const more = element("details"), list = element("div", "", { class: "many" });
      list.append(...buttons(others));
      more.append(element("summary", `${plural(others.length, "other term")} for ${left}`), list);
      line.append(more);
    }
    return line;
  }));
  if (focused) $("terms").querySelector(`[aria-label="${CSS.escape(focused)}"]`)?.focus();
}

function termButton(j, left, term) {
  const button = element("button", pretty(term), { "aria-label": `${term} in ${left}`, "data-equation": j, "data-term": term });
  if (state.found.known[j].includes(term)) button.title = "Fixed coefficient";
  button.addEventListener("click", () => trying("terms_failed", () => toggle(j, term)));
  return button;
}

/** Show which terms are wanted. */
function press() {
  for (const button of $("terms").querySelectorAll("button")) {
    const { equation, term } = button.dataset;
    button.disabled = state.busy || !state.found.others || state.found.known[equation].includes(term);
    button.setAttribute("aria-pressed", String(state.wanted[equation].includes(term)));
  }
}

const same = (one, other) => one.every((own, j) => own.length === other[j].length && own.every(term => other[j].includes(term)));

/** Take a term of an equation in or out, and fit the law of these terms if it is not there yet. */
async function toggle(j, term) {
  const { search, found } = state, path = `searches/${search}/terms`;
  const terms = state.wanted.map((own, i) => i !== j ? own : own.includes(term) ? own.filter(each => each !== term) : [...own, term]);
  const at = found.candidates.findIndex(each => same(each.terms, terms));
  if (at >= 0) return move(at);
  state.wanted = terms;
  press();
  try {
    begin("fitting");
    await ask(path, "POST", { terms });
    await followFit();
  } catch (error) {
    if (state.found !== found || state.wanted !== terms) return;
    $("fitting").hidden = true;
    move(state.at);
    throw error;
  }
}

/** Wait for the law of other terms; it is then among the candidates, and shown if it is still wanted. */
export async function followFit() {
  const { search, found } = state, now = state.fit = {};
  const told = await follow(`searches/${search}/terms`, "fitting", () => state.search !== search || state.fit !== now);
  if (!told) return;
  const { wanted } = state;
  showMore((await ask(`searches/${search}/found`)).found);
  if (same(found.candidates[told.at].terms, wanted)) move(told.at);
}
