// The studio: values go to the engine, and the cell and the text of the configuration come back. What only changes the
// kernels' radii or the level is shown at once, before the engine has answered.
const studio = jsonOf("head-studio"), changed = new Map();
const waited = studio.part ? ["E", "k", "verdict"] : studio.alone ? [] : ["solid", "void", "E"];
const counted = studio.alone ? ["pores", "tunnels", "level", "pore_radius", "tunnel_radius"] : ["pores", "tunnels"];
const twice = studio.part || Boolean(studio.alone); // drawn quickly first, and exactly after a pause
let live = null, request = null, timer = 0, patience = 0, last = null, base = new Map(), saveAnyway = false;

const all = (selector, root = document) => [...root.querySelectorAll(selector)];
const target = () => (byId("target") ? byId("target").value : "");
const panel = () => all(".target").find((one) => !one.hidden);
const controlOf = (key) => all(".control", panel()).find((one) => one.dataset.key === key);
const numberOf = (text) => parseFloat(text);
// What stands behind a number of a length: its unit.
const unitOf = (value) => (typeof value === "string" ? value.replace(/^[-+\d.eE]+/, "") : "");

function valueOf(control) {
  const { kind } = control.dataset, start = JSON.parse(control.dataset.value);
  if (kind === "flag") return control.querySelector("input").checked;
  if (kind === "choice") return control.querySelector("select").value || null;
  const values = all(".number", control).map((box) => {
    const text = box.value.trim();
    if (text === "") return null;
    return /^[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$/.test(text) ? Number(text) : text;
  });
  return Array.isArray(start) ? values : values[0];
}

function show(control, value) {
  const { kind } = control.dataset;
  if (kind === "flag") control.querySelector("input").checked = value;
  else if (kind === "choice") control.querySelector("select").value = value ?? "";
  else {
    (Array.isArray(value) ? value : [value]).forEach((one, i) => {
      const part = all(".part", control)[i], slider = part.querySelector("[type=range]");
      part.querySelector(".number").value = one ?? "";
      if (slider && one !== null) slider.value = String(numberOf(one));
    });
  }
}

// Remember a value, unless it is that of the file.
function take(control) {
  const value = valueOf(control), same = JSON.stringify(value) === JSON.stringify(JSON.parse(control.dataset.value));
  if (same) changed.delete(control.dataset.key);
  else changed.set(control.dataset.key, value);
  for (const twin of all(".control").filter((one) => one.dataset.key === control.dataset.key)) {
    twin.classList.toggle("changed", !same);
    if (twin !== control) show(twin, value);
  }
  last = control;
}

// Radii and level as the kernels feel them, from those of the last answer to those of now.
function preview(coarse) {
  if (!live || live.head().kind !== "kernels") return;
  const now = instants(), was = (name) => base.get(name), power = live.head().power;
  const ratio = (name) => (was(name) && now.get(name) ? now.get(name) / was(name) : 1);
  let pore = ratio("pore_radius") / Math.sqrt(ratio("omega")), tunnel = ratio("tunnel_radius") / ratio("mu") ** (1 / power), level = null;
  const c = now.get("level"), c0 = was("level");
  // a level that a later stage has set is not ours to move
  if (c && c0 && c !== c0 && c < 1 && Math.abs(live.head().level - c0) < 1e-9) {
    const wider = Math.log(1 / c0) / Math.log(1 / c);
    level = c;
    if (was("pore_radius")) pore *= Math.sqrt(wider);
    if (was("tunnel_radius")) tunnel *= wider ** (1 / power);
  }
  // kernels that reach over many cells take the browser seconds, and the engine refuses the widest
  if ([pore, tunnel].every((ratio) => ratio > 0.2 && ratio < 4)) live.preview(pore, tunnel, level, coarse);
}

const instants = () => new Map(all("[data-instant]", panel()).filter((one) => one.dataset.instant)
  .map((one) => [one.dataset.instant, numberOf(valueOf(one))]).filter(([, value]) => value > 0));

function said(text, busy = false) {
  byId("status").textContent = text;
  byId("status").classList.toggle("busy", busy);
}

// What was changed before, to go back to, and what was gone back from.
const past = [], future = [];
let present = "[]";

function remember() {
  const now = JSON.stringify([...changed]);
  if (now === present) return;
  past.push(present);
  future.length = 0;
  present = now;
  steps();
}

function steps() {
  byId("back").disabled = !past.length;
  byId("forth").disabled = !future.length;
}

// Give all controls these values, and those of the file to the others.
function restore(entries) {
  const values = new Map(entries);
  changed.clear();
  for (const control of all(".control")) {
    const { key, value } = control.dataset, other = values.has(key);
    show(control, other ? values.get(key) : JSON.parse(value));
    if (other) changed.set(key, values.get(key));
    control.classList.toggle("changed", other);
  }
  draw(twice);
}

function travel(from, to) {
  if (!from.length) return;
  to.push(present);
  present = from.pop();
  steps();
  restore(JSON.parse(present));
}

function clearFaults() {
  for (const one of all(".fault")) one.hidden = true;
  for (const one of all(".faulty")) one.classList.remove("faulty");
}

function showFaults(errors) {
  clearFaults();
  const seen = new Map();
  for (const { key, stage, message, hint } of errors) {
    // an error of a stage as a whole is shown at the control that was moved last
    const moved = last && panel().contains(last) ? last : null;
    const control = controlOf(key) || moved;
    const group = all("fieldset", panel()).find((one) => one.dataset.stage === stage);
    const place = control || group, box = place ? place.querySelector(":scope > .fault") : byId("fault");
    const words = (control && !controlOf(key) && stage ? `${stage}: ` : "") + message + (hint ? ` (${hint})` : "");
    seen.set(box, [...(seen.get(box) || []), words]);
    if (control) control.classList.add("faulty");
  }
  for (const [box, words] of seen) {
    box.textContent = [...new Set(words)].join("; ");
    box.hidden = false;
  }
}

const query = () => new URLSearchParams({ target: target(), changes: JSON.stringify(Object.fromEntries(changed)) });

function number(key, text, old = false) {
  const box = document.querySelector(`[data-number=${key}]`);
  if (text !== null) box.textContent = text;
  box.classList.toggle("old", old);
}

// A part is drawn quickly first, and as it will be once nothing has been moved for a while.
async function draw(quick = false) {
  if (request) request.abort();
  const own = (request = new AbortController()), asked = query();
  if (quick) asked.set("quick", "1");
  clearTimeout(patience);
  said(live || studio.alone ? "drawing…" : "drawing; the first time kernels are compiled, which takes some seconds…", true);
  for (const key of waited) number(key, null, true);
  try {
    const answer = await (studio.alone ? answerAlone(asked) : fetch(`cell?${asked}`, { signal: own.signal }));
    if (answer.status === 409) return;
    if (!answer.ok) {
      showFaults((await answer.json()).errors);
      said("not drawn; shown is the last cell that could be");
      return;
    }
    const bytes = new Uint8Array(await answer.arrayBuffer());
    if (own !== request) return;
    const length = new DataView(bytes.buffer).getUint32(0, true);
    const head = JSON.parse(new TextDecoder().decode(bytes.subarray(4, 4 + length)));
    await answered(head, bytes.subarray(4 + length));
    if (head.quick) patience = setTimeout(() => draw(), 500);
    else if (!studio.alone) patience = setTimeout(() => count(asked, own), 700);
  } catch (error) {
    if (error.name !== "AbortError") said(`no answer: ${error.message}. Is \`sppm studio\` still running?`);
  }
}

async function answered(head, view) {
  clearFaults();
  byId("yaml").textContent = head.yaml;
  byId("yaml").dataset.digest = head.digest;
  const link = byId("download");
  if (link.href.startsWith("blob:")) URL.revokeObjectURL(link.href);
  link.href = URL.createObjectURL(new Blob([head.yaml], { type: "application/yaml" }));
  if (head.part) partSaid(head);
  else if (head.porosity !== null) number("porosity", `${(100 * head.porosity).toFixed(2)} %`);
  if (!studio.part) for (const key of counted) number(key, key in head.numbers ? String(head.numbers[key]) : "–");
  byId("warnings").replaceChildren(...head.warnings.map((words) => Object.assign(document.createElement("li"), { textContent: words })));
  base = instants();
  if (live) await live.load(view);
  else {
    live = await startLive(view);
    if (live && studio.part) { // a skin would hide all that is inside
      byId("live-cut").value = "0.62";
      byId("live-cut").dispatchEvent(new Event("input"));
    }
  }
  if (live) {
    const { pores, periodic } = live.head(), tiles = byId("live-tile");
    byId("live-repeats").hidden = !periodic;
    byId("live-tiles").hidden = !pores || pores.length < 2;
    while (tiles.length > (pores || []).length) tiles.remove(tiles.length - 1);
    while (pores && tiles.length < pores.length) tiles.add(new Option(String(tiles.length)));
  }
  Object.assign(byId("status").dataset, { drawn: head.digest, seconds: String(head.seconds), quick: head.quick ? "1" : "" });
  said(`${head.quick ? (studio.part ? "preview: one block of 27 cells, repeated," : "preview") : "drawn"} in ${head.seconds.toFixed(2)} s`);
}

// Connectivity and stiffness, once nothing has been moved for a while.
async function count(asked, own) {
  said(`${byId("status").textContent}; computing stiffness…`, true);
  try {
    const answer = await fetch(`numbers?${asked}`, { signal: own.signal });
    if (answer.status === 409 || own !== request) return;
    const found = await answer.json();
    said(answer.ok ? byId("status").textContent.split(";")[0] : (found.errors ?? []).map((e) => e.message).join(" "));
    if (studio.part) return partCounted(found, asked, own);
    for (const phase of ["solid", "void"]) {
      const c = found.connectivity;
      number(phase, c ? `${c[`${phase}_components`] === 1 ? "one piece" : `${c[`${phase}_components`]} pieces`}${c[`${phase}_wraps`].every(Boolean) ? "" : ", not through"}` : "–");
    }
    number("E", found.elastic ? found.elastic.E.map((e) => (e ?? 0).toPrecision(2)).join(", ") : "–");
  } catch (error) {
    if (error.name !== "AbortError") said(String(error.message));
  }
}

function moved(control, soon) {
  take(control);
  if (!soon) remember();
  preview(soon);
  later(soon);
}

function later(soon) {
  clearTimeout(timer);
  timer = setTimeout(() => draw(twice), soon ? 90 : 0);
}

for (const control of all(".control")) {
  show(control, JSON.parse(control.dataset.value));
  all(".part", control).forEach((part, i) => {
    const slider = part.querySelector("[type=range]"), box = part.querySelector(".number");
    if (slider) {
      const start = [JSON.parse(control.dataset.value)].flat()[i];
      slider.addEventListener("input", () => { box.value = slider.value + unitOf(start); moved(control, true); });
      slider.addEventListener("change", () => { remember(); preview(false); });
    }
    box.addEventListener("change", () => {
      if (slider && !Number.isNaN(numberOf(box.value))) slider.value = String(numberOf(box.value));
      moved(control, false);
    });
  });
  for (const one of all("select, [type=checkbox]", control)) one.addEventListener("change", () => moved(control, false));
}
for (const button of all(".next")) {
  button.addEventListener("click", () => {
    const control = button.parentElement.querySelector(".control");
    show(control, Number(valueOf(control)) + 1);
    moved(control, false);
  });
}
if (byId("target")) {
  byId("target").addEventListener("change", () => {
    for (const one of all(".target")) one.hidden = one.dataset.target !== target();
    draw();
  });
}
byId("undo").addEventListener("click", () => { restore([]); remember(); });
byId("back").addEventListener("click", () => travel(past, future));
byId("forth").addEventListener("click", () => travel(future, past));
document.addEventListener("keydown", (event) => {
  // text boxes undo by themselves
  if (event.key.toLowerCase() !== "z" || !(event.ctrlKey || event.metaKey) || event.target.matches(".number")) return;
  event.preventDefault();
  if (event.shiftKey) travel(future, past);
  else travel(past, future);
});
byId("copy").addEventListener("click", async () => {
  const file = studio.file || `${studio.name}.yaml`, command = studio.alone ? byId("yaml").textContent : `sppm run ${/^[\w./-]+$/.test(file) ? file : `'${file.replaceAll("'", "'\\''")}'`}`;
  try {
    await navigator.clipboard.writeText(command);
    byId("said").textContent = studio.alone ? "copied" : `copied: ${command}`;
  } catch (error) {
    byId("said").textContent = studio.alone ? "not copied: select the text below" : command;
  }
});
if (byId("save")) {
  byId("save").addEventListener("click", async () => {
    try {
      const answer = await fetch("save", { method: "POST", body: JSON.stringify({ changes: Object.fromEntries(changed), anyway: saveAnyway }) });
      const found = await answer.json();
      saveAnyway = answer.status === 409; // only a change that the user has seen may be replaced
      byId("save").textContent = saveAnyway ? "save all the same" : "save";
      byId("said").textContent = answer.ok ? `saved ${found.saved}` : found.errors.map((one) => one.message).join("; ");
    } catch (error) {
      byId("said").textContent = `not saved: ${error.message}`;
    }
  });
}
steps();
if (!studio.alone || !fromAddress()) draw(twice);
