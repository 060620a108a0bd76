// Pictures of a law, as matplotlib draws them: seen here, and taken away as files or as the program that draws them.
import { $, element, reach, state, trying } from "./basics.js";
import { take } from "./take.js";

/** Offer the pictures of the candidate that is shown; what was drawn of another is seen no more. */
export function offerFigures() {
  const { figures, equations } = state.found.candidates[state.at], before = $("figure").value;
  $("figures").hidden = false;
  $("figure").replaceChildren(...figures.map(({ name, title }) => element("option", title, { value: name })));
  if (figures.some(each => each.name === before)) $("figure").value = before;
  $("figure_object").replaceChildren(...state.found.objects.map(name => element("option", name, { value: name })));
  $("figure_parameter").replaceChildren(...Object.keys(equations?.values ?? {}).map(name => element("option", name, { value: name })));
  choose();
}

export function choose() {
  const { object, parameter } = chosen();
  $("figure_object_part").hidden = !object || state.found.objects.length < 2;
  $("figure_parameter_part").hidden = !parameter;
  $("drawn").hidden = true;
  $("figure_failed").textContent = "";
}

const chosen = () => state.found.candidates[state.at].figures.find(each => each.name === $("figure").value);

/** A file as an address that holds it, so that it is not drawn again to be shown. */
function read(file) {
  return new Promise(done => {
    const reader = new FileReader();
    reader.onload = () => done(reader.result);
    reader.readAsDataURL(file);
  });
}

let serial = 0;

export async function drawFigure() {
  const { name, title, object, parameter } = chosen(), asked = new URLSearchParams({ candidate: state.at });
  if (object) asked.set("object", $("figure_object").value);
  if (parameter) asked.set("parameter", $("figure_parameter").value);
  const address = ending => `searches/${state.search}/figures/${name}.${ending}?${asked}`, now = ++serial;
  $("drawn").hidden = true;
  $("drawing").textContent = "Drawing ...";
  await trying("figure_failed", async () => {
    const drawn = await read(await (await reach(address("svg"))).blob());
    if (now !== serial) return;
    $("picture").src = drawn;
    $("picture").alt = [title, object ? $("figure_object").value : "", parameter ? $("figure_parameter").value : ""].filter(Boolean).join(", ");
    for (const ending of ["svg", "png", "py"]) Object.assign($(`figure_${ending}`), { href: address(ending), download: `${name}.${ending}`, onclick: take });
    $("drawn").hidden = false;
  });
  if (now === serial) $("drawing").textContent = "";
}
