// The live view of a page: its controls, the porosity they give, and the plane that it shares with the layers. What it
// returns takes other data, and other radii and levels of the kernels, than those it began with; null without WebGL 2.
async function startLive(bytes) {
  const live = byId("live"), canvas = byId("live-canvas"), still = byId("still");
  let view, kernels, design, porosity, loaded, finer = 0;
  try {
    view = headOf(bytes).head.kind === "mesh" ? new MeshView(canvas) : new View(canvas);
  } catch (error) {
    byId("live-note").hidden = false;
    return null;
  }
  let { head, arrays } = await readView(bytes);
  const slider = (name) => byId(`live-${name}`), state = { tile: 0, pore: 1, tunnel: 1, cells: null };

  function begin(n) {
    kernels = head.kind === "kernels";
    design = (head.level - head.base) / head.top;
    Object.assign(state, { pore: 1, tunnel: 1 });
    if (state.tile >= (kernels ? head.pores.length : 1)) state.tile = 0;
    fill(n);
    view.level = design;
    if (slider("level")) slider("level").value = String(design);
  }

  const part = (array, counts, width) => {
    const first = counts.slice(0, state.tile).reduce((a, b) => a + b, 0);
    return array.subarray(width * first, width * (first + counts[state.tile]));
  };

  // A few cells of a tiling, summed; what the part leaves of them is known from the coarser samples of the whole.
  function fillCells() {
    const { explore } = head, m = 3, n = 24, side = m * n, edge = head.edge_mm || 1, h = head.size[0] / head.shape[0];
    const low = state.cells.map((c) => c - 1), field = sumBytes(sumCells(explore, arrays, low, m, n), head.top);
    let domain = null;
    if (arrays.domain) {
      const [nx, ny, nz] = head.shape, scale = (h * n) / edge;
      const corner = low.map((c, a) => (head.lattice_mm[a] + c * edge - head.origin[a]) / h - 0.5);
      domain = new Uint8Array(side ** 3);
      const place = (i, a) => Math.max(0, Math.min(head.shape[a] - 1.001, corner[a] + ((i + 0.5) * edge) / (n * h)));
      for (let k = 0, s = 0; k < side; k++) for (let j = 0; j < side; j++) for (let i = 0; i < side; i++, s++) {
        const p = [place(i, 0), place(j, 1), place(k, 2)], f = p.map(Math.floor), w = p.map((v, a) => v - f[a]);
        let value = 0;
        for (let c = 0; c < 8; c++) {
          const b = [c & 1, (c >> 1) & 1, c >> 2];
          const weight = b.reduce((all, on, a) => all * (on ? w[a] : 1 - w[a]), 1);
          value += weight * arrays.domain[((f[2] + b[2]) * ny + f[1] + b[1]) * nx + f[0] + b[0]];
        }
        domain[s] = Math.max(0, Math.min(255, 127.5 + (value - 127.5) * scale));
      }
    }
    view.load(field, domain, [side, side, side], [1, 1, 1], false);
    porosity = new Porosity(field, domain);
  }

  function fill(n) {
    if (state.cells) return fillCells();
    if (head.kind === "mesh") {
      view.loadMesh(arrays.vertices, arrays.faces, head.size, head.closed, arrays.still);
    } else if (kernels) {
      const sums = sumKernels(head, part(arrays.pores, head.pores, 4), part(arrays.tunnels, head.tunnels, 7), n, state.pore, state.tunnel);
      const field = sumBytes(sums, head.top);
      loaded = [field, null, [n, n, n], [1, 1, 1], true];
      view.load(...loaded);
      porosity = new Porosity(field, null);
    } else {
      const largest = Math.max(...head.size);
      loaded = [arrays.field, arrays.domain || null, head.shape, head.size.map((s) => s / largest), head.periodic];
      view.load(...loaded);
      porosity = new Porosity(arrays.field, arrays.domain || null);
    }
  }

  function said() {
    if (!porosity || !slider("readout")) return;
    const recorded = kernels ? head.tile_porosity[state.tile] ?? null : head.porosity;
    const asDesigned = Math.abs(view.level - design) < 1e-6 && state.pore === 1 && state.tunnel === 1 && !state.cells;
    const value = asDesigned && recorded !== null ? recorded : porosity.at(view.level);
    const level = head.base + view.level * head.top;
    slider("readout").textContent = `porosity ${(100 * value).toFixed(2)} %, ${head.level_name} ${level.toPrecision(4)}`;
    Object.assign(slider("readout").dataset, { porosity: String(value), level: String(level) });
  }

  function cutSaid() {
    const { axis, at } = view.cut, edge = head.edge_mm || 1;
    const z = state.cells ? head.lattice_mm[axis] + (state.cells[axis] - 1 + 3 * at) * edge
      : head.origin[axis] + at * head.size[axis] * view.repeat;
    slider("cut-readout").textContent = at < 1 ? `${"xyz"[axis]} ${z.toPrecision(4)} ${head.unit === "cell" ? "cells" : head.unit}` : "no cut";
    canvas.dataset.cut = at < 1 ? String(z) : "";
    return z;
  }

  // A bar of 1, 2 or 5 times a power of ten, where the page has a place for one.
  function scaleSaid() {
    const bar = byId("live-scale"), { width: w, height: h } = canvas, largest = kernels ? head.size[0] : Math.max(...head.size);
    if (!bar || !view.span) return;
    const pixel = (Math.max(view.span[0] / (0.92 * w), view.span[1] / (0.92 * h)) / view.camera.zoom) * largest * (w / canvas.clientWidth);
    const power = 10 ** Math.floor(Math.log10(130 * pixel)), length = power * [5, 2, 1].find((n) => n * power <= 130 * pixel);
    bar.style.width = `${length / pixel}px`;
    bar.textContent = `${Number(length.toPrecision(1))} ${head.unit}`;
  }

  const settle = (full) => { fill(full ? head.n : Math.min(head.n, 40)); said(); view.changed(); };
  const on = (name, event, act) => slider(name) && slider(name).addEventListener(event, act);

  begin(head.n);
  // a picture is shown as large as its place, the still picture's if there is one
  const room = (live.parentElement.clientWidth || 800), ratio = Math.min(1.5, window.devicePixelRatio || 1);
  canvas.width = Math.round(Math.min(room, 1000) * ratio);
  canvas.height = Math.round(canvas.width * (room < 500 ? 0.9 : 0.64));
  view.fit();

  on("level", "input", (event) => { view.level = +event.target.value; said(); view.changed(); });
  on("design", "click", () => {
    Object.assign(state, { pore: 1, tunnel: 1 });
    for (const name of ["pore", "tunnel"]) if (slider(name)) slider(name).value = "1";
    view.level = design;
    slider("level").value = String(design);
    if (kernels) fill(head.n);
    said();
    view.changed();
  });
  for (const name of ["pore", "tunnel"]) {
    on(name, "input", (event) => { state[name] = +event.target.value; settle(false); });
    on(name, "change", () => settle(true));
  }
  on("tile", "change", (event) => { state.tile = +event.target.value; settle(true); });
  on("repeat", "change", (event) => { view.repeat = +event.target.value; view.fit(); cutSaid(); view.changed(); });
  const cut = () => {
    view.cut = { axis: +slider("axis").value, at: +slider("cut").value };
    const place = cutSaid();
    if (view.cut.axis === 2) document.dispatchEvent(new CustomEvent("sppm-height", { detail: place }));
    view.changed();
  };
  on("cut", "input", cut);
  on("axis", "change", cut);
  const move = () => {
    const share = +slider("moved").value;
    view.share = share;
    slider("moved-readout").textContent = share ? `${Number((share * head.magnified).toPrecision(3))} times` : "as it was";
    view.changed();
  };
  on("moved", "input", move);
  const explore = () => {
    state.cells = slider("explore").checked ? ["x", "y", "z"].map((name) => +slider(`cell-${name}`).value) : null;
    fill(head.n);
    view.fit();
    said();
    cutSaid();
    canvas.dataset.cells = state.cells ? state.cells.join(" ") : "";
    view.changed();
  };
  on("explore", "change", explore);
  for (const name of ["x", "y", "z"]) on(`cell-${name}`, "change", () => { slider("explore").checked = true; explore(); });
  on("reset", "click", () => { view.camera.reset(); view.fit(); view.changed(); });
  document.addEventListener("sppm-cut", (event) => {
    if (state.cells) return;
    const at = Math.max(0.001, Math.min(1, (event.detail - head.origin[2]) / head.size[2]));
    view.cut = { axis: 2, at };
    slider("axis").value = "2";
    slider("cut").value = String(at);
    cutSaid();
    view.changed();
  });

  const fingers = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    const last = fingers.get(event.pointerId);
    if (!last) return;
    const dx = event.clientX - last[0], dy = event.clientY - last[1], height = canvas.clientHeight;
    if (fingers.size === 2) {
      const [other] = [...fingers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
      const far = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]);
      zoom(far([event.clientX, event.clientY]) / Math.max(1, far(last)));
    } else if (event.shiftKey || event.buttons === 2) {
      view.camera.shift = [view.camera.shift[0] - dx / height, view.camera.shift[1] + dy / height];
    } else {
      view.camera.turn(dx * 0.4, dy * 0.4);
    }
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    view.changed();
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => fingers.delete(event.pointerId));
  const zoom = (factor) => { view.camera.zoom = Math.max(0.3, Math.min(30, view.camera.zoom * factor)); view.changed(); };
  canvas.addEventListener("wheel", (event) => { if (event.ctrlKey || document.activeElement === canvas) { event.preventDefault(); zoom(Math.exp(-event.deltaY / 600)); } }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const turns = { ArrowLeft: [-8, 0], ArrowRight: [8, 0], ArrowUp: [0, -8], ArrowDown: [0, 8] }[event.key];
    if (turns) view.camera.turn(-turns[0], -turns[1]);
    else if (event.key === "+" || event.key === "-") zoom(event.key === "+" ? 1.2 : 1 / 1.2);
    else return;
    event.preventDefault();
    view.changed();
  });
  canvas.addEventListener("webglcontextlost", (event) => {
    event.preventDefault();
    live.hidden = true;
    if (still) still.hidden = false;
    byId("live-note").hidden = false;
  });

  const marks = [...live.getElementsByClassName("mark")];
  view.onframe = (ms) => {
    marks.forEach((mark, i) => {
      const largest = Math.max(...head.size), p = head.marks[i].slice(1).map((v, a) => (v - head.origin[a]) / largest);
      const [x, y, behind] = view.screen(p);
      mark.style.left = `${100 * x}%`;
      mark.style.top = `${100 * y}%`;
      mark.classList.toggle("behind", behind || state.cells !== null);
    });
    scaleSaid();
    Object.assign(canvas.dataset, { passes: String(view.passes), most: String(view.most), scale: String(view.scale), ms: String(Math.round(ms)) });
    if (live.hidden) {
      live.hidden = false;
      if (still) still.hidden = true;
    }
  };
  said();
  cutSaid();
  if (slider("moved")) move();
  view.changed();
  return {
    head: () => head,
    shown: () => ({ view, loaded }),
    async load(data) {
      const before = JSON.stringify(view.size);
      ({ head, arrays } = await readView(data));
      begin(Math.min(head.n, 40));
      clearTimeout(finer);
      if (kernels) finer = setTimeout(() => { fill(head.n); said(); view.changed(); }, 250);
      if (!head.periodic) view.repeat = 1;
      if (slider("repeat") && !head.periodic) slider("repeat").value = "1";
      if (JSON.stringify(view.size) !== before) view.fit();
      said();
      cutSaid();
      view.changed();
    },
    // Factors of the radii, and a level or null for that of the data; coarse while something is being moved.
    preview(pore, tunnel, level, coarse) {
      clearTimeout(finer);
      if (pore !== state.pore || tunnel !== state.tunnel || !coarse) {
        Object.assign(state, { pore, tunnel });
        fill(coarse ? Math.min(head.n, 40) : head.n);
      }
      view.level = level === null ? design : (level - head.base) / head.top;
      said();
      view.changed();
    },
  };
}

const started = byId("data-view") ? startLive(bytesOf("data-view")) : null;
