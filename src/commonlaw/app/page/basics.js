// What all parts of the page share: what they know, asking the server, making elements, waiting for work.

export const $ = id => document.getElementById(id);
export const state = { table: null, search: null, preview: null, found: null, columns: {}, at: 0, written: null, excluding: false, session: null };

/** What the server answers; where it does not, or refuses, what has happened and what to do. */
export async function reach(path, options = {}) {
  const answer = await fetch(path, options).catch(() => {
    throw new Error("The app no longer runs: its command was ended, or its computer sleeps. Start commonlaw app again and open the address that it prints; what this page shows stays to be read until it is closed.");
  });
  if (!answer.ok) throw new Error((await content(answer)).error ?? `the server refused this (${answer.status}): start the app again`);
  return answer;
}

export async function ask(path, method = "GET", body = undefined) {
  return content(await reach(path, { method, body: body instanceof Blob || body === undefined ? body : JSON.stringify(body) }));
}

/** The JSON of an answer; an empty object if there is none. */
const content = answer => answer.headers.get("content-type")?.startsWith("application/json") ? answer.json() : {};

export function element(kind, text = "", attributes = {}) {
  const made = document.createElement(kind);
  made.textContent = text;
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
}

export function fill(table, head, rows) {
  const line = (cells, kind) => { const row = element("tr"); row.append(...cells.map(each => element(kind, each ?? "", kind === "th" ? { scope: "col" } : {}))); return row; };
  table.tHead.replaceChildren(line(head, "th"));
  table.tBodies[0].replaceChildren(...rows.map(row => line(row, "td")));
}

/** Show a message; its code, in brackets at its end, leads to the explanation. */
export function tell(place, text) {
  const [, sentence, code] = text.match(/^(.*) \[([a-z0-9-]+)\]$/s) ?? [null, text, ""];
  place.replaceChildren(sentence, ...code ? [" ", element("a", code, { href: `messages/${code}`, target: "_blank", rel: "noopener" })] : []);
  return place;
}

export function plural(count, word) {
  return `${count} ${word}${count === 1 ? "" : "s"}`;
}

export function withUnit({ name, unit }) {
  return unit ? `${name} (${unit})` : name;
}

/** A term, with powers raised. */
export function pretty(term) {
  return term.replace(/\^(\d+)/g, (_, power) => [...power].map(digit => "⁰¹²³⁴⁵⁶⁷⁸⁹"[digit]).join(""));
}

/** What trials are called: by their object, and by their own label if an object has several. */
export function labels(trials) {
  const { trial } = state.preview.roles, several = new Set(trials.map(each => each.object)).size < trials.length;
  return trials.map(({ object, name }) => (/^[\d.]+$/.test(object) ? `object ${object}` : object) + (several ? `, ${trial} ${name}` : ""));
}

/** A number as people write it: six digits, and none that is only rounding. */
export function tidy(number) {
  return Number(number.toPrecision(6));
}

export function remember() {
  const kept = Object.entries({ table: state.table, search: state.search }).filter(([, value]) => value);
  history.replaceState(null, "", `#${new URLSearchParams(kept)}`);
}

export async function trying(place, work) {
  $(place).textContent = "";
  try {
    await work();
  } catch (error) {
    tell($(place), error.message);
  }
}

/** Show that work begins. */
export function begin(place) {
  showStages(place, { stages: [] });
  showInterim(place, "");
  $(place).hidden = false;
}

/**
 * Wait for work of the server to end, and return what is told then; null if `left` says that nobody waits any more.
 * Whenever it has made something, `made` is called.
 */
export async function follow(path, place, left, made = async () => {}) {
  begin(place);
  $(`${place}_cancel`).onclick = () => ask(path, "DELETE");
  const stop = $(`${place}_stop`);
  if (stop) stop.onclick = () => { stop.disabled = true; ask(`${path}/stop`, "POST"); };
  for (let before = 0; ;) {
    const work = await ask(path);
    if (left()) return null;
    if (work.made > before) await made();
    before = work.made;
    $(place).hidden = !work.running;
    if (work.failure) throw new Error(work.failure);
    if (!work.running) return work;
    showStages(place, work);
    showInterim(place, work.interim);
    await new Promise(done => setTimeout(done, 400));
  }
}

/** Show the best law so far, with which a search can be stopped. */
function showInterim(place, interim) {
  const law = $(`${place}_law`), stop = $(`${place}_stop`);
  if (!law) return;
  if (law.textContent !== interim) law.textContent = interim;
  stop.hidden = !interim;
  if (!interim) stop.disabled = false;
}

/** Show what is being done, and below what was done, the latest first; how long it took, of several in a row together. */
function showStages(place, { stages, done = null }) {
  const rows = [];
  for (const [what, seconds] of stages) {
    if (rows[0]?.what === what) rows[0].seconds += seconds;
    else rows.unshift({ what, seconds });
  }
  const [now, ...before] = rows, stage = $(`${place}_stage`), bar = $(place).querySelector("progress");
  // Said aloud when it changes, and not every second
  if (stage.textContent !== (now?.what ?? "")) stage.textContent = now?.what ?? "";
  if (done === null) bar.removeAttribute("value");
  else bar.value = done;
  $(`${place}_time`).textContent = now ? `(${[`${Math.round(now.seconds)} s`, ...whole(stages, done)].join(", ")})` : "";
  $(`${place}_done`).replaceChildren(...before.map(({ what, seconds }) => element("li", seconds < 0.05 ? what : `${what}: ${seconds < 10 ? seconds.toFixed(1) : Math.round(seconds)} s`)));
}

const TOLD = 0.05;

/** How much of the whole is done, and about how long the rest takes at the pace until now. */
function whole(stages, done) {
  if (done === null || done < TOLD) return [];
  const earlier = stages.slice(0, -1).reduce((sum, [, seconds]) => sum + seconds, 0), now = stages.at(-1)[1];
  const left = earlier / done - earlier - now;
  return [`${Math.round(100 * done)} % of the whole`, ...left > 1 ? [`about ${left < 100 ? `${Math.round(left)} s` : `${Math.round(left / 60)} min`} left`] : []];
}
