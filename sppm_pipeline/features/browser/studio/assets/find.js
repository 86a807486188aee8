// The chart of the atlas: designs that meet conditions, two properties of one's choice, and a click that opens the cell.
if (byId("find")) {
  const M = { left: 66, right: 14, top: 26, bottom: 40 }, W = 720, H = 400, form = byId("find").querySelector("form"), fault = byId("find").querySelector(".fault");
  const [chart, said_] = [byId("chart"), byId("found")], axes = [byId("find-x"), byId("find-y")], KEY = "sppm-find";
  let designs = [], asked = null, taken = -1;
  const add = (kind, attributes, parent = chart) => {
    const one = document.createElementNS("http://www.w3.org/2000/svg", kind);
    for (const [name, value] of Object.entries(attributes)) one.setAttribute(name, value);
    parent.append(one);
    return one;
  };
  const digits = (v) => String(Number(v.toPrecision(3)));
  const unit = (name) => (asked.cell ? { permeability: "mm²", surface: "1/mm", strut: "mm", strut_thinnest: "mm", pore: "mm" }[name] ?? "" : "");
  const words = (name) => `${name}${unit(name) ? `, ${unit(name)}` : ""}`;
  const summary = (d) => `${d.family}, ${d.total} pores a cell: ${axes.map(({ value: name }) => `${name} ${digits(d.values[name][1])} (${digits(d.values[name][0])} to ${digits(d.values[name][2])}) ${unit(name)}`.trim()).join(", ")}`;

  // Logarithmic places along an axis, and its marks: 1, 2, 5 times powers of ten, and more where these are few.
  function axis(name, from, to) {
    const values = designs.map((d) => d.values[name][1]), [low, high] = [Math.min(...values) / 1.15, Math.max(...values) * 1.15].map(Math.log);
    const place = (v) => from + ((to - from) * (Math.log(v) - low)) / (high - low);
    const powers = [0, 1, 2, 3, 4, 5].map((p) => 10 ** (Math.floor(low / Math.LN10) + p)), steps = [[1, 2, 5], [1, 2, 3, 5, 7], [1, 1.5, 2, 3, 4, 5, 6, 7, 8, 9]];
    const marks = steps.map((some) => powers.flatMap((p) => some.map((m) => m * p)).filter((v) => Math.log(v) > low && Math.log(v) < high));
    return { place, marks: marks.find((some) => some.length > 3) ?? marks[2] };
  }

  function plot() {
    const [x, y] = [axis(axes[0].value, M.left, W - M.right), axis(axes[1].value, H - M.bottom, M.top)], at = (d) => axes.map((a, i) => [x, y][i].place(d.values[a.value][1]));
    chart.replaceChildren();
    chart.toggleAttribute("hidden", !designs.length);
    for (const v of x.marks) {
      add("line", { class: "grid", x1: x.place(v), x2: x.place(v), y1: M.top, y2: H - M.bottom });
      add("text", { x: x.place(v), y: H - M.bottom + 15, "text-anchor": "middle" }).textContent = digits(v);
    }
    for (const v of y.marks) {
      add("line", { class: "grid", y1: y.place(v), y2: y.place(v), x1: M.left, x2: W - M.right });
      add("text", { x: M.left - 6, y: y.place(v) + 4, "text-anchor": "end" }).textContent = digits(v);
    }
    add("text", { x: (M.left + W - M.right) / 2, y: H - 6, "text-anchor": "middle" }).textContent = words(axes[0].value);
    add("text", { transform: `translate(14 ${H / 2}) rotate(-90)`, "text-anchor": "middle" }).textContent = words(axes[1].value);
    const families = [...new Set(designs.map((d) => d.family))].sort();
    families.forEach((family, i) => {
      add("circle", { class: `f${i}`, r: 5, cx: M.left + 8 + 125 * i, cy: 12 });
      add("text", { x: M.left + 18 + 125 * i, y: 16 }).textContent = family;
    });
    // designs that none has more of both
    let best = -Infinity;
    const front = [...designs].sort((a, b) => at(b)[0] - at(a)[0]).filter((d) => -at(d)[1] > best && ((best = -at(d)[1]), true)).map(at);
    add("path", { class: "front", d: front.map(([a, b], i) => (i ? `H${a}V${b}` : `M${a} ${b}`)).join("") });
    designs.forEach((d, i) => {
      const [cx, cy] = at(d), [bx, by] = axes.map((a, k) => [d.values[a.value][0], d.values[a.value][2]].map([x, y][k].place));
      const point = add("circle", { class: `design f${families.indexOf(d.family)}${i === taken ? " taken" : ""}`, r: 6, cx, cy, tabindex: 0, role: "button", "aria-label": summary(d) });
      add("path", { class: "bar", d: `M${bx[0]} ${cy}H${bx[1]}M${cx} ${by[0]}V${by[1]}` });
      for (const event of ["mouseenter", "focus"]) point.addEventListener(event, () => { said_.textContent = summary(d); });
      point.addEventListener("click", () => open(i));
      point.addEventListener("keydown", (event) => { if (event.key === "Enter" || event.key === " ") { event.preventDefault(); open(i); } });
    });
  }

  async function find(number = -1) {
    asked = { conditions: byId("conditions").value, cell: byId("find-cell").value.trim() };
    fault.hidden = true;
    try {
      const answer = await fetch(`find?${new URLSearchParams(asked)}`), found = await answer.json();
      designs = answer.ok ? found.designs : [];
      taken = number;
      if (!answer.ok) throw new Error(found.errors.map(({ message, hint }) => message + (hint ? ` (${hint})` : "")).join("; "));
    } catch (error) {
      fault.textContent = error.message;
      fault.hidden = false;
      said_.textContent = "";
      chart.toggleAttribute("hidden", true);
      return;
    }
    const chosen = axes.map((a) => a.value);
    axes.forEach((a, k) => {
      a.replaceChildren(...Object.keys(designs[0].values).map((name) => new Option(name)));
      a.value = chosen[k] || ["E_relative", "permeability"][k];
    });
    plot();
    said_.textContent = taken >= 0 ? `open: ${summary(designs[taken])}` : `${designs.length} designs`;
  }

  async function open(number) {
    const answer = await fetch(`open?${new URLSearchParams({ ...asked, number })}`, { method: "POST" });
    if (!answer.ok) {
      said_.textContent = (await answer.json()).errors.map((one) => one.message).join("; ");
      return;
    }
    sessionStorage.setItem(KEY, JSON.stringify({ ...asked, number, axes: axes.map((a) => a.value) }));
    location.reload();
  }

  form.addEventListener("submit", (event) => { event.preventDefault(); find(); });
  for (const a of axes) a.addEventListener("change", plot);
  byId("find").addEventListener("toggle", () => { if (byId("find").open && !designs.length && fault.hidden) find(); });
  const before = JSON.parse(sessionStorage.getItem(KEY) ?? "null");
  if (before) { // the page of a design that was found: the chart stays
    sessionStorage.removeItem(KEY);
    [byId("conditions").value, byId("find-cell").value] = [before.conditions, before.cell];
    axes.forEach((a, k) => { a.add(new Option(before.axes[k])); a.value = before.axes[k]; });
    find(before.number).then(() => { byId("find").open = true; });
  }
}
