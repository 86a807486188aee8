// Parts in the studio: numbers in mm, ml, g and h, sliders that move two others, files, and a design beside another.
let sizes = null, other = null, numbersOfA = null;

const short = (value, digits = 3) => (value === undefined || value === null ? "–" : String(Number(value.toPrecision(digits))));
const hours = (s) => (s === undefined || s === null ? "–" : s < 5400 ? `${short(s / 60, 2)} min` : `${short(s / 3600, 3)} h`);
const percent = (value, digits = 1) => (value === undefined || value === null ? "–" : `${(100 * value).toFixed(digits)} %`);

// At once, from the coarse samples that are shown.
function partSaid({ part, porosity, quick }) {
  const design = part.sizes ?? {}, about = quick ? "≈ " : "";
  sizes = { ...design, edge_mm: part.edge_mm };
  number("porosity", about + percent(part.porosity ?? porosity));
  number("infill", about + percent(part.infill ?? design.porosity));
  number("ml", `${about}${short(part.ml)} ml`);
  number("g", part.g === undefined ? "–" : `${about}${short(part.g)} g`);
  number("h", hours(part.seconds));
  number("struts", design.strut ? `${short(design.strut)} / ${short(design.pore)} mm` : "–");
  number("cell", `${short(part.edge_mm)} mm`);
  number("drains", quick ? null : String(part.drains));
  byId("size").textContent = `${part.size_mm.map((v) => short(v)).join(" × ")} mm${part.printer ? `, ${part.printer}` : ""}`;
  for (const link of all(".linked")) {
    const value = link.dataset.link === "cell" ? part.edge_mm : design.porosity, [slider, box] = all("input", link);
    if (document.activeElement === slider && slider.matches(":active")) continue;
    if (link.dataset.link === "cell") Object.assign(slider, { min: short(value / 3, 2), max: short(value * 3, 2) });
    slider.value = value;
    box.value = short(value);
  }
}

// Stiffness and permeability of the infill; then, if that does not take long, all that the configuration says.
async function partCounted(found, asked, own) {
  const mean = (values) => values.reduce((a, b) => a + (b ?? 0), 0) / values.length;
  number("E", found.elastic ? `${short(mean(found.elastic.E), 2)} E_s` : "–");
  number("k", found.flow && found.flow.darcy_mean ? `${short(found.flow.darcy_mean * 9.869e-7, 2)} mm²` : "–");
  if (own !== request) return;
  await printed(asked, own, false);
}

// What a run of the whole configuration says, to the digit; `long` also if that takes long.
async function printed(asked, own, long) {
  const before = byId("status").textContent.split(";")[0];
  said(`${before}; slicing…`, true);
  const answer = await fetch(`run?${asked}${long ? "&long=1" : ""}`, { signal: own.signal });
  if (answer.status === 409 || own !== request) return;
  const run = await answer.json();
  said(before);
  if (!answer.ok) {
    number("verdict", run.errors.map((one) => one.message).join("; "));
    return;
  }
  if (run.expected_s) {
    number("verdict", `layers take about ${hours(run.expected_s)}: “print file” makes them`);
    return;
  }
  number("porosity", percent(run.porosity, 2));
  number("infill", percent(run.infill_porosity, 2));
  number("ml", `${short((run.solid_volume_mm3 ?? 0) / 1000, 4)} ml`);
  if (run.resin_g !== undefined) number("g", `${short(run.resin_g, 4)} g`);
  if (run.print_time_s !== undefined) number("h", hours(run.print_time_s));
  number("verdict", run.verdict ?? "–");
  Object.assign(byId("numbers").dataset, { porosity: String(run.porosity), volume: String(run.solid_volume_mm3), text: byId("yaml").dataset.digest });
}

// Struts and pores of one ratio grow with the cell; a porosity changes their ratio, by the law that estimates use, and
// the engine then says what it has become.
function linked(name, value, soon) {
  if (!sizes || !sizes.strut || !(value > 0) || (name === "porosity" && value >= 1)) return;
  const [strut, pore] = ["strut", "pore"].map((size) => all(".control", panel()).find((one) => one.dataset.role === `design.sizes.${size}`));
  let s = sizes.strut, p = sizes.pore;
  if (name === "cell") [s, p] = [s, p].map((size) => (size * value) / sizes.edge_mm);
  else {
    const odds = (porosity) => (1 - porosity) / porosity, whole = s + p;
    const ratio = (s / p) * (odds(value) / odds(sizes.porosity)) ** 0.55;
    [s, p] = [(whole * ratio) / (1 + ratio), whole / (1 + ratio)];
  }
  for (const [control, size] of [[strut, s], [pore, p]]) {
    show(control, `${short(size)} mm`);
    take(control);
  }
  if (!soon) remember();
  later(soon);
}

for (const link of document.querySelectorAll(".linked")) {
  const [slider, box] = link.querySelectorAll("input");
  slider.addEventListener("input", () => { box.value = short(+slider.value); linked(link.dataset.link, +slider.value, true); });
  slider.addEventListener("change", () => remember());
  box.addEventListener("change", () => linked(link.dataset.link, parseFloat(box.value), false));
}

// Files that the engine makes.
async function fetchFile(what, button) {
  const asked = query(), own = (request = (request && request.abort(), new AbortController()));
  clearTimeout(patience);
  asked.set("what", what);
  button.disabled = true;
  said(`making the ${button.textContent}…`, true);
  try {
    const answer = await fetch(`file?${asked}`, { signal: own.signal });
    if (answer.status === 409) return said("stopped, as something was moved");
    if (!answer.ok) return said((await answer.json()).errors.map((one) => one.message + (one.hint ? ` (${one.hint})` : "")).join("; "));
    const name = decodeURIComponent(answer.headers.get("Content-Disposition").split("''")[1]), link = document.createElement("a");
    link.href = URL.createObjectURL(await answer.blob());
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 60000);
    said(`made ${name}`);
    if (what === "print" || what === "report") await printed(query(), own, true);
  } catch (error) {
    said(error.name === "AbortError" ? "stopped, as something was moved" : `not made: ${error.message}`);
  } finally {
    button.disabled = false;
  }
}

for (const button of document.querySelectorAll("[data-file]")) {
  button.addEventListener("click", () => fetchFile(button.dataset.file, button));
}

// The design as it is, beside those that follow: seen from the same side, and cut at the same place.
function keepA() {
  const { view, loaded } = live.shown();
  if (!other) {
    byId("other").hidden = false;
    byId("live-frame").classList.add("pair");
    const canvas = byId("other-canvas"), own = view.canvas;
    [canvas.width, canvas.height] = [own.width, own.height];
    other = new View(canvas);
    const before = view.onframe;
    view.onframe = (ms) => {
      before(ms);
      if (view.passes === 1) look();
    };
  }
  other.load(...loaded);
  Object.assign(other, { camera: view.camera, level: view.level, repeat: view.repeat });
  other.fit();
  look();
  numbersOfA = JSON.stringify([...changed]);
  for (const box of document.querySelectorAll("[data-number]")) {
    const beside = document.querySelector(`[data-a=${box.dataset.number}]`);
    if (beside) beside.textContent = `A: ${box.textContent}`;
  }
  byId("to-a").hidden = false;
}

function look() {
  const { view } = live.shown();
  other.cut = view.cut;
  other.changed();
}

byId("keep").addEventListener("click", () => { if (live) keepA(); });
byId("to-a").addEventListener("click", () => { restore(JSON.parse(numbersOfA)); remember(); });

// Meshes are dropped or chosen; what they are made to, and for which printer, begins them anew. Why one was refused stays
// to be read until the next, whatever the part that is still shown is doing meanwhile.
async function open(search, body) {
  const refused = byId("refused"), before = byId("status").textContent;
  refused.hidden = true;
  said("reading…", true);
  let words;
  try {
    const answer = await fetch(`open?${search}`, { method: "POST", body });
    if (answer.ok) return location.reload();
    const text = await answer.text();
    words = text;
    try {
      words = JSON.parse(text).errors.map((one) => one.message + (one.hint ? ` (${one.hint})` : "")).join("; ");
    } catch (error) { /* a plain text */ }
  } catch (error) {
    words = `not read: ${error.message}`;
  }
  refused.textContent = words;
  refused.hidden = false;
  if (byId("status").textContent === "reading…") said(before);
}

const dropped = (file) => file && open(new URLSearchParams({ name: file.name }), file);
if (byId("mesh")) {
  byId("mesh").addEventListener("change", (event) => dropped(event.target.files[0]));
  for (const name of ["dragenter", "dragover"]) {
    document.addEventListener(name, (event) => {
      if (![...event.dataTransfer.types].includes("Files")) return;
      event.preventDefault();
      document.body.classList.add("dropping");
    });
  }
  document.addEventListener("dragleave", (event) => { if (!event.relatedTarget) document.body.classList.remove("dropping"); });
  document.addEventListener("drop", (event) => {
    event.preventDefault();
    document.body.classList.remove("dropping");
    dropped(event.dataTransfer.files[0]);
  });
}
for (const id of ["design", "printer"]) {
  if (byId(id)) {
    byId(id).addEventListener("change", () => open(new URLSearchParams({
      design: byId("design").value, printer: byId("printer").value, changes: JSON.stringify(Object.fromEntries(changed)),
    })));
  }
}
