// The studio without a server: what the engine would answer is computed here, and the address holds the configuration.
const lone = jsonOf("head-studio").alone;
let drawnGraph = null;

// The literal text between the values, and the values' keys: [key, place in a list or null].
const literals = lone.spots.map(([, , start], i) => lone.text.slice(i ? lone.spots[i - 1][3] : 0, start));
literals.push(lone.text.slice(lone.spots[lone.spots.length - 1][3]));

const textOf = (values) => literals.map((part, i) => {
  if (i === lone.spots.length) return part;
  const [key, item] = lone.spots[i], value = item === null ? values[key] : values[key][item];
  return part + (typeof value === "string" ? value : JSON.stringify(value));
}).join("");

// The values of a text of the same form, comments and spaces aside; null of any other.
function valuesOf(text) {
  const plain = (part) => part.replace(/^[ \t]*#.*\n/gm, "").replace(/\r/g, "").replace(/[ \t]+/g, " ");
  const form = literals.map((part) => plain(part).trim().replace(/[.*+?^${}()|[\]\\]/g, "\\$&")).map((part) => part.replace(/\s*\n\s*/g, "\\s*\\n\\s*"));
  const found = new RegExp(`^\\s*${form.join("\\s*([^,}\\]\\n#]+?)\\s*")}\\s*$`).exec(plain(`${text}\n`));
  if (!found) return null;
  const values = {};
  lone.spots.forEach(([key, item], i) => {
    const word = found[i + 1], value = word !== "" && Number.isFinite(Number(word)) ? Number(word) : word;
    if (item === null) values[key] = value;
    else (values[key] ??= [])[item] = value;
  });
  return values;
}

function checked(values) {
  const named = (key) => lone.roles[key];
  for (const [key, value] of Object.entries(values)) {
    const role = named(key), [low, high, whole] = lone.limits[role];
    for (const one of [value].flat()) {
      const length = role === "edge" ? /^([-+\d.eE]+) ?mm$/.exec(String(one)) : null, number = role === "edge" ? Number(length && length[1]) : one;
      if (typeof number !== "number" || !(number >= low && number <= high) || (whole && !Number.isInteger(number))) {
        throw new Refused(role, `${JSON.stringify(one)} is not allowed`, `allowed here ${whole ? "are integers" : "is"} from ${low} to ${high}${role === "edge" ? ' mm, as in "5 mm"' : ""}`);
      }
    }
  }
  const cell = Object.fromEntries(Object.entries(values).map(([key, value]) => [named(key), value]));
  if (cell.degree[0] > cell.degree[1]) throw new Refused("degree", `the degree bounds [${cell.degree}] are in the wrong order`, "put the smaller one first");
  const depth = Math.log(1 / CUTOFF) / Math.log(1 / cell.level), reach = { pore_radius: cell.pore_radius * Math.sqrt(depth), tunnel_radius: cell.tunnel_radius * depth };
  for (const [role, far] of Object.entries(reach)) {
    if (far > 1.5) throw new Refused(role, `its kernels reach ${far.toPrecision(3)} cell sizes`, "at most 1.5 are summed here; give a smaller radius or level, or use `sppm studio`");
  }
  return cell;
}

async function packed(head, arrays) {
  const blobs = [], listed = [];
  for (const [name, array] of Object.entries(arrays)) {
    const stream = new Blob([array]).stream().pipeThrough(new CompressionStream("gzip"));
    blobs.push(new Uint8Array(await new Response(stream).arrayBuffer()));
    listed.push({ name, bytes: blobs[blobs.length - 1].length, type: "f32", count: array.length, delta: false });
  }
  return new Blob([`sppmview 1\n${JSON.stringify({ ...head, blobs: listed })}\n`, ...blobs]).arrayBuffer();
}

// What the engine's `cell` answers, and the view file.
async function answerAlone(search) {
  const began = performance.now(), changes = JSON.parse(search.get("changes")), quick = Boolean(search.get("quick"));
  const values = { ...lone.values, ...changes };
  try {
    const cell = checked(values), { pore_radius, tunnel_radius, porosity: target } = cell, made = JSON.stringify([cell.seed, cell.pores, cell.share, cell.degree]);
    const graph = drawnGraph && drawnGraph.made === made ? drawnGraph : { made, ...graphOf(cell) };
    drawnGraph = graph;
    const kernels = kernelsOf(graph, cell), { level, porosity } = quick ? { level: levelFor(sumsOff(kernels, 32), target), porosity: target } : await tuned(kernels, target, 64);
    const radii = level < 1 ? [Math.sqrt(Math.log(1 / level) / kernels.omega), Math.log(1 / level) / kernels.mu] : [NaN, NaN], edge = parseFloat(cell.edge);
    const yaml = textOf(values), head = {
      kind: "kernels", title: "Microstructure", n: 64, cells: [1, 1, 1], edge_mm: edge, unit: "mm", size: [edge, edge, edge], origin: [0, 0, 0],
      level, top: 3 * level, base: 0, level_name: "level C", domain: false, periodic: true, ...LAW,
      pores: [graph.centers.length], tunnels: [graph.edges.length], porosity: quick ? null : porosity, tile_porosity: quick ? [] : [porosity], explore: null,
    };
    const said = {
      yaml, digest: sha256(yaml).map((v) => v.toString(16).padStart(8, "0")).join(""), part: null, porosity, quick, warnings: [],
      numbers: { pores: graph.centers.length, tunnels: graph.edges.length, level: level.toPrecision(4), ...Object.fromEntries(["pore", "tunnel"].map((name, i) => [`${name}_radius`, `${(radii[i] * edge).toPrecision(3)} mm`])) },
    };
    if (radii.some((r, i) => Math.abs(r / [pore_radius, tunnel_radius][i] - 1) > 0.1)) said.warnings.push(`the level for this porosity changes the radii by more than 10 %: pores ${radii[0].toPrecision(3)} in place of ${pore_radius}, tunnels ${radii[1].toPrecision(3)} in place of ${tunnel_radius} cell sizes`);
    try {
      history.replaceState(null, "", `#${encodeURIComponent(yaml)}`);
    } catch (error) { /* a frame without an address of its own */ }
    const view = await packed(head, kernels.arrays), words = new TextEncoder().encode(JSON.stringify({ ...said, seconds: (performance.now() - began) / 1000 }));
    return new Response(new Blob([new Uint32Array([words.length]), words, view]));
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    const key = Object.keys(lone.roles).find((one) => lone.roles[one] === error.key) ?? "";
    return new Response(JSON.stringify({ errors: [{ key, stage: "", message: error.message, hint: error.hint }] }), { status: 422 });
  }
}

// Take over the configuration that the address holds; false if there is none.
function fromAddress() {
  let text;
  try {
    text = decodeURIComponent(location.hash.slice(1));
  } catch (error) {
    text = location.hash;
  }
  const refused = byId("refused"), values = text && valuesOf(text);
  refused.hidden = !text || values !== null;
  if (!text) return false;
  if (values === null) {
    refused.textContent = "The address holds a configuration of another form than this page can draw; save its text as a file, and open it with `sppm studio FILE`.";
    return false;
  }
  restore(Object.entries(values).filter(([key, value]) => JSON.stringify(value) !== JSON.stringify(lone.values[key])));
  remember();
  return true;
}

window.addEventListener("hashchange", () => { if (location.hash !== `#${encodeURIComponent(byId("yaml").textContent)}`) fromAddress(); });
