// A sweep: a scatter of two columns, with filters, a Pareto line and ticks; the table of its rows; what a point leads to.
{
  const head = jsonOf("head-rows"), table = byId("rows"), body = table.tBodies[0], more = byId("rows-more");
  const canvas = byId("scatter"), readout = byId("scatter-readout"), chips = byId("filters"), ink = canvas.getContext("2d");
  const PORTION = 200, M = { left: 70, right: 16, top: 14, bottom: 46 }, ticked = new Set(), filters = new Map();
  const columnOf = (name) => head.names.indexOf(name), RUN = columnOf("run"), STATUS = columnOf("status");
  let rows = [], shown = [], count = 0, by = -1, down = false, picked = null, brush = null, live = null, views = null, turn = 0;
  // as the rows that stand in the page are written: six digits, powers of ten for what is small or large
  const text = (value) => {
    if (value === null) return "";
    if (typeof value === "boolean") return value ? "True" : "False";
    if (typeof value !== "number" || Number.isInteger(value)) return String(value);
    const short = +value.toPrecision(6), size = Math.abs(short);
    return size >= 1e-4 && size < 1e6 ? String(short) : short.toExponential().replace(/e([+-])(\d)$/, "e$10$2");
  };
  const label = (c) => head.words[c] + (head.units[c] ? `, ${head.units[c]}` : "");
  const made = (kind, words, parent) => { const one = document.createElement(kind); one.textContent = words; if (parent) parent.append(one); return one; };

  // The table
  function fill(upTo) {
    for (; count < Math.min(upTo, shown.length); count++) {
      const row = shown[count], line = body.insertRow(), box = made("input", "", line.insertCell());
      Object.assign(box, { type: "checkbox", checked: ticked.has(row), onchange: () => tick(row, box.checked) });
      box.setAttribute("aria-label", `tick run ${row[RUN]}`);
      for (const value of row) line.insertCell().textContent = text(value);
      line.onclick = (event) => { if (event.target !== box) pick(row); };
      line.classList.toggle("picked", row === picked);
      line.row = row;
    }
    byId("rows-readout").textContent = `${count} of ${shown.length} rows` + (shown.length < rows.length ? ` that pass the filters, of ${rows.length}` : "");
    more.hidden = count >= shown.length;
  }

  function compare(a, b) {
    if (a === null || b === null) return (a === null) - (b === null);
    if (typeof a === "number" && typeof b === "number") return down ? b - a : a - b;
    return down ? String(b).localeCompare(String(a)) : String(a).localeCompare(String(b));
  }

  function refill() {
    shown = rows.filter((row) => [...filters].every(([c, [low, high]]) => row[c] !== null && row[c] >= low && row[c] <= high));
    body.replaceChildren();
    count = 0;
    fill(PORTION);
    draw();
  }

  function sort(column, heading) {
    down = by === column && !down;
    by = column;
    for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
    heading.setAttribute("aria-sort", down ? "descending" : "ascending");
    rows.sort((a, b) => compare(a[column], b[column]));
    refill();
  }

  // The scatter
  const axes = () => [+byId("axis-x").value, +byId("axis-y").value];
  const points = () => { const [x, y] = axes(); return shown.filter((row) => typeof row[x] === "number" && typeof row[y] === "number"); };
  let scale = null;

  function range(values) {
    const low = Math.min(...values), high = Math.max(...values), room = 0.05 * (high - low) || 0.05 * Math.abs(high) || 1;
    return [low - room, high + room];
  }

  function ticks([low, high], about) {
    const step0 = (high - low) / about, power = 10 ** Math.floor(Math.log10(step0));
    const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= step0), found = [];
    for (let k = Math.ceil(low / step); k * step <= high; k++) found.push(k * step);
    return found;
  }

  // Points that none of the others is better than in both: signs are 1 where more is better, -1 where less is.
  function pareto(some, [x, y], [sx, sy]) {
    let best = -Infinity;
    return [...some].sort((a, b) => sx * (b[x] - a[x]) || sy * (b[y] - a[y])).filter((row) => sy * row[y] > best && ((best = sy * row[y]), true));
  }

  function draw() {
    const ratio = window.devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight, style = getComputedStyle(document.documentElement);
    const color = (name) => style.getPropertyValue(`--${name}`), some = points(), [x, y] = axes();
    canvas.width = Math.round(w * ratio);
    canvas.height = Math.round(h * ratio);
    ink.setTransform(ratio, 0, 0, ratio, 0, 0);
    ink.font = "12px system-ui, sans-serif";
    const all = rows.filter((row) => typeof row[x] === "number" && typeof row[y] === "number");
    if (!all.length) return;
    const [rx, ry] = [range(all.map((row) => row[x])), range(all.map((row) => row[y]))];
    scale = {
      x: (v) => M.left + ((v - rx[0]) / (rx[1] - rx[0])) * (w - M.left - M.right), y: (v) => h - M.bottom - ((v - ry[0]) / (ry[1] - ry[0])) * (h - M.top - M.bottom),
      ofX: (p) => rx[0] + ((p - M.left) / (w - M.left - M.right)) * (rx[1] - rx[0]), ofY: (p) => ry[0] + ((h - M.bottom - p) / (h - M.top - M.bottom)) * (ry[1] - ry[0]),
    };
    ink.strokeStyle = color("line");
    ink.fillStyle = color("ink");
    ink.textAlign = "center";
    for (const t of ticks(rx, Math.max(3, w / 110))) { line(scale.x(t), M.top, scale.x(t), h - M.bottom); ink.fillText(String(+t.toPrecision(5)), scale.x(t), h - M.bottom + 16); }
    ink.fillText(label(x), (M.left + w - M.right) / 2, h - 8);
    ink.textAlign = "right";
    for (const t of ticks(ry, 5)) { line(M.left, scale.y(t), w - M.right, scale.y(t)); ink.fillText(String(+t.toPrecision(5)), M.left - 6, scale.y(t) + 4); }
    ink.save();
    ink.translate(14, (M.top + h - M.bottom) / 2);
    ink.rotate(-Math.PI / 2);
    ink.textAlign = "center";
    ink.fillText(label(y), 0, 0);
    ink.restore();
    const dot = (row, r) => { ink.beginPath(); ink.arc(scale.x(row[x]), scale.y(row[y]), r, 0, 7); };
    ink.fillStyle = color("line");
    for (const row of all) { dot(row, 2.5); ink.fill(); }
    ink.fillStyle = color("c0");
    ink.globalAlpha = 0.75;
    for (const row of some) { dot(row, 4); ink.fill(); }
    ink.globalAlpha = 1;
    const signs = [+byId("better-x").value, +byId("better-y").value];
    const front = signs.every(Boolean) ? pareto(some, [x, y], signs) : [];
    ink.strokeStyle = color("c1");
    ink.lineWidth = 2;
    ink.beginPath();
    front.forEach((row, i) => ink[i ? "lineTo" : "moveTo"](scale.x(row[x]), scale.y(row[y])));
    ink.stroke();
    ink.fillStyle = color("c1");
    for (const row of front) { dot(row, 4); ink.fill(); }
    ink.strokeStyle = color("ink");
    for (const row of ticked) if (typeof row[x] === "number" && typeof row[y] === "number") { dot(row, 7); ink.stroke(); }
    if (picked && typeof picked[x] === "number" && typeof picked[y] === "number") { ink.lineWidth = 3; dot(picked, 10); ink.stroke(); }
    ink.lineWidth = 1;
    if (brush) ink.strokeRect(brush[0], brush[1], brush[2] - brush[0], brush[3] - brush[1]);
    readout.textContent = `${some.length} of ${rows.length} points` + (front.length ? `, ${front.length} on the Pareto line` : "");
    Object.assign(canvas.dataset, { points: String(some.length), pareto: front.map((row) => row[RUN]).join(" ") });
  }
  function line(a, b, c, d) { ink.beginPath(); ink.moveTo(a, b); ink.lineTo(c, d); ink.stroke(); }

  function setFilter(c, low, high) {
    if (low === null) filters.delete(c); else filters.set(c, [low, high]);
    chips.replaceChildren(...[...filters].map(([column, [a, b]]) => {
      const chip = made("button", `${label(column)}: ${+a.toPrecision(4)} to ${+b.toPrecision(4)} ✕`);
      chip.title = "remove this filter";
      chip.onclick = () => setFilter(column, null);
      return chip;
    }));
    refill();
  }

  const placeOf = (event) => { const box = canvas.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
  canvas.addEventListener("pointerdown", (event) => { brush = [...placeOf(event), ...placeOf(event)]; canvas.setPointerCapture(event.pointerId); });
  canvas.addEventListener("pointermove", (event) => { if (brush) { brush.splice(2, 2, ...placeOf(event)); draw(); } });
  canvas.addEventListener("pointerup", () => {
    const [x, y] = axes(), [a, b, c, d] = brush;
    brush = null;
    if (!scale) return;
    if (Math.hypot(c - a, d - b) < 6) {
      const far = (row) => Math.hypot(scale.x(row[x]) - a, scale.y(row[y]) - b);
      const near = points().reduce((best, row) => (!best || far(row) < far(best) ? row : best), null);
      if (near && far(near) < 24) pick(near); else draw();
      return;
    }
    const sorted = (u, v) => [Math.min(u, v), Math.max(u, v)];
    filters.set(x, sorted(scale.ofX(a), scale.ofX(c)));
    setFilter(y, ...sorted(scale.ofY(b), scale.ofY(d)));
  });
  canvas.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 }[event.key], [x] = axes();
    if (event.key === "Enter" && picked) tick(picked, !ticked.has(picked));
    if (!step) return;
    event.preventDefault();
    const order = points().sort((a, b) => a[x] - b[x]), at = order.indexOf(picked);
    if (order.length) pick(order[at < 0 ? 0 : (at + step + order.length) % order.length]);
  });

  // What a point leads to
  const quoted = (value) => (/^[\w.,:+/-]+$/.test(text(value)) ? text(value) : `'${text(value).replaceAll("'", "'\\''")}'`);
  function command(row) {
    const own = Object.fromEntries(head.params.map((name) => [name, row[columnOf(name)]])), all = { ...head.base, ...own };
    const words = Object.entries(all).map(([name, value]) => (name === "seed" && !(name in head.base) ? `--seed ${quoted(value)}` : `-p ${name}=${quoted(value)}`));
    if (!("seed" in own)) words.push(`--seed ${head.seed}`);
    return `sppm run ${quoted(head.file)} ${words.join(" ")} -o picked/${row[RUN]}`;
  }

  async function pick(row) {
    picked = row;
    const panel = byId("point"), mine = ++turn;
    panel.hidden = false;
    byId("point-name").textContent = `run ${row[RUN]}`;
    byId("point-command").textContent = command(row);
    byId("point-tick").checked = ticked.has(row);
    byId("point-numbers").replaceChildren(...head.names.map((_, c) => {
      const one = made("div", "");
      made("dt", label(c), one);
      made("dd", text(row[c]), one);
      return one;
    }));
    const figure = document.querySelector(`#multiples [data-run="${row[RUN]}"] img`), picture = byId("point-picture");
    picture.hidden = !figure;
    if (figure) picture.src = figure.src;
    const at = head.views.findIndex(([run]) => run === row[RUN]), place = byId("point-live");
    if (place) place.hidden = at < 0;
    byId("point-none").hidden = at >= 0;
    for (const one of body.rows) one.classList.toggle("picked", one.row === row);
    canvas.dataset.picked = row[RUN];
    draw();
    if (at < 0) return;
    views ??= bytesOf("data-views");
    const bytes = views.slice(head.views[at][1], head.views[at][2]);
    if (!live) live = startLive(bytes);
    else { const there = await live; if (there && mine === turn) await there.load(bytes); }
    place.dataset.run = row[RUN];
  }

  function tick(row, on) {
    if (on) ticked.add(row); else ticked.delete(row);
    byId("short").hidden = !ticked.size;
    byId("short-rows").textContent = [...ticked].map(command).join("\n");
    if (picked === row) byId("point-tick").checked = on;
    for (const line of body.rows) if (line.row === row) line.cells[0].firstChild.checked = on;
    draw();
  }

  unpacked(bytesOf("data-rows")).then((bytes) => {
    rows = JSON.parse(new TextDecoder().decode(bytes));
    table.tHead.rows[0].prepend(made("th", "✓"));
    [...table.tHead.rows[0].cells].slice(1).forEach((heading, column) => {
      heading.dataset.sort = "";
      heading.tabIndex = 0;
      heading.addEventListener("click", () => sort(column, heading));
      heading.addEventListener("keydown", (event) => { if (event.key === "Enter") sort(column, heading); });
    });
    more.addEventListener("click", () => fill(count + PORTION));
    byId("rows-controls").hidden = false;
    for (const name of ["axis-x", "axis-y", "filter-column"]) {
      for (const c of head.axes) made("option", label(c), byId(name)).value = String(c);
      byId(name).value = String(head.first[name === "axis-y" ? 1 : 0]);
    }
    byId("explore").hidden = head.axes.length < 2;
    for (const name of ["axis-x", "axis-y", "better-x", "better-y"]) byId(name).addEventListener("change", draw);
    byId("filter-add").addEventListener("click", () => {
      const ends = ["filter-low", "filter-high"].map((name) => byId(name).value.trim());
      setFilter(+byId("filter-column").value, ends[0] === "" ? -Infinity : +ends[0], ends[1] === "" ? Infinity : +ends[1]);
    });
    byId("point-tick").addEventListener("change", (event) => tick(picked, event.target.checked));
    for (const one of document.querySelectorAll("#multiples [data-run]")) one.addEventListener("click", () => { const row = rows.find((r) => r[RUN] === one.dataset.run); if (row) pick(row); });
    for (const copy of document.querySelectorAll("[data-copy]")) copy.addEventListener("click", () => navigator.clipboard.writeText(byId(copy.dataset.copy).textContent));
    window.addEventListener("resize", draw);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
    refill();
  });
}
