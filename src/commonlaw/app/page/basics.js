// What all parts of the page share: what they know, asking the server, making elements, waiting for work.

export const $ = id => document.getElementById(id);
export const state = { table: null, search: null, preview: null, found: null, columns: {}, at: 0 };

export async function ask(path, method = "GET", body = undefined) {
  const answer = await fetch(path, { method, body: body instanceof Blob || body === undefined ? body : JSON.stringify(body) });
  const said = answer.headers.get("content-type")?.startsWith("application/json") ? await answer.json() : {};
  if (!answer.ok) throw new Error(said.error ?? `the server refused this (${answer.status}): start the app again`);
  return said;
}

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
  const several = new Set(trials.map(each => each.object)).size < trials.length;
  return trials.map(({ object, name }) => (/^[\d.]+$/.test(object) ? `object ${object}` : object) + (several ? `, trial ${name}` : ""));
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
    $(place).textContent = error.message;
  }
}

/** Show that work begins. */
export function begin(place) {
  showStages(place, []);
  $(place).hidden = false;
}

/**
 * Wait for work of the server to end, and return what is told then; null if `left` says that nobody waits any more.
 * Whenever it has made something, `made` is called.
 */
export async function follow(path, place, left, made = async () => {}) {
  begin(place);
  $(`${place}_cancel`).onclick = () => ask(path, "DELETE");
  for (let before = 0; ;) {
    const told = await ask(path);
    if (left()) return null;
    if (told.made > before) await made();
    before = told.made;
    $(place).hidden = !told.running;
    if (told.failure) throw new Error(told.failure);
    if (!told.running) return told;
    showStages(place, told.stages);
    await new Promise(done => setTimeout(done, 400));
  }
}

/** Show what is being done, and below what was done, the latest first; how long it took, of several in a row together. */
function showStages(place, stages) {
  const rows = [];
  for (const [what, seconds] of stages) {
    if (rows[0]?.what === what) rows[0].seconds += seconds;
    else rows.unshift({ what, seconds });
  }
  const [now, ...done] = rows, stage = $(`${place}_stage`);
  // Said aloud when it changes, and not every second
  if (stage.textContent !== (now?.what ?? "")) stage.textContent = now?.what ?? "";
  $(`${place}_seconds`).textContent = now ? `${Math.round(now.seconds)} s` : "";
  $(`${place}_done`).replaceChildren(...done.map(({ what, seconds }) => element("li", seconds < 0.05 ? what : `${what}: ${seconds < 10 ? seconds.toFixed(1) : Math.round(seconds)} s`)));
}
