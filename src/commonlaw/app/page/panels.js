// Small multiples: a picture of each object, all on the same axes, found by name.
import { $, element } from "./basics.js";
import { colorOf } from "./plots.js";

const WIDTH = 160, HEIGHT = 90, FEW = 6;
const shown = new Map();

/** Make a panel for each object; one that is clicked is chosen, with Shift or Control beside the others. */
export function showPanels(objects, choose) {
  shown.clear();
  $("find").value = "";
  $("finding").hidden = objects.length <= FEW;
  $("panels").replaceChildren(...objects.map(object => {
    const button = element("button", "", { title: object });
    button.innerHTML = `<svg viewBox="0 0 ${WIDTH} ${HEIGHT}" preserveAspectRatio="none" aria-hidden="true"></svg>`;
    button.append(element("span", object));
    button.addEventListener("click", event => choose(object, event.shiftKey || event.ctrlKey || event.metaKey));
    shown.set(object, button);
    return button;
  }));
  findPanels();
}

/** Leave the panels whose objects have what is sought in their names. */
export function findPanels() {
  const sought = $("find").value.trim().toLowerCase();
  let count = 0;
  for (const [object, button] of shown) {
    button.hidden = !object.toLowerCase().includes(sought);
    count += !button.hidden;
  }
  $("matching").textContent = `${count} of ${shown.size}`;
}

export function markPanels(chosen) {
  for (const [object, button] of shown) button.setAttribute("aria-pressed", String(chosen.has(object)));
}

/** Draw the curves of each object into its panel. */
export function updatePanels(curves) {
  const own = new Map([...shown.keys()].map(object => [object, []]));
  for (const each of curves) own.get(each.object)?.push(each);
  const x = scale(curves.flatMap(each => each.t), WIDTH, false), y = scale(curves.flatMap(each => [...each.points, ...each.line ?? []]), HEIGHT, true);
  // Paths of numbers and colours of this page's own
  for (const [object, button] of shown) button.firstElementChild.innerHTML = own.get(object).map(each => picture(each, x, y)).join("");
}

function scale(values, length, up) {
  let [low, high] = [Infinity, -Infinity];
  for (const value of values) if (value !== null) [low, high] = [Math.min(low, value), Math.max(high, value)];
  const span = high - low || 1, inner = length - 8;
  return value => ((up ? high - value : value - low) / span * inner + 4).toFixed(1);
}

function picture({ t, points, line, low, high, color }, x, y) {
  const at = (values, ends = "L") => t.flatMap((time, i) => values[i] === null ? [] : [`${x(time)} ${y(values[i])}${ends}`]);
  const curve = values => at(values, "").join("L"), stroke = colorOf(color);
  const band = low ? `<path fill="${stroke}" opacity=".18" d="M${[...at(high, ""), ...at(low, "").reverse()].join("L")}Z"/>` : "";
  const path = line ? `<path class="line" stroke="${stroke}" d="M${curve(line)}"/>` : "";
  return `${band}${path}<path class="points" stroke="${stroke}" d="${at(points, "h0").map(each => `M${each}`).join("")}"/>`;
}
