// The layers: PNG files out of one block of bytes, decoded by the browser; slider, keys, play, and clicks on the chart.
{
  const head = jsonOf("head-layers"), data = bytesOf("data-layers");
  const canvas = byId("layer"), slider = byId("layer-slider"), readout = byId("layer-readout"), play = byId("layer-play");
  const context = canvas.getContext("2d"), chart = byId("layers-chart");
  let wanted = Math.floor(head.numbers.length / 2), busy = false, timer = 0, cursor = null;

  const heightOf = (index) => head.origin_mm[2] + (head.numbers[index] + 0.5) * head.layer_mm;

  async function draw() {
    if (busy) return;
    busy = true;
    let index;
    do {
      index = wanted;
      const file = new Blob([data.subarray(head.ends[index], head.ends[index + 1])], { type: "image/png" });
      const image = await createImageBitmap(file, { colorSpaceConversion: "none" });
      canvas.width = image.width;
      canvas.height = image.height;
      context.drawImage(image, 0, 0);
      image.close();
    } while (index !== wanted);
    busy = false;
    canvas.dataset.layer = String(head.numbers[index]);
    canvas.setAttribute("aria-label", `layer ${head.numbers[index]} of ${head.count}`);
  }

  function show(index, quietly) {
    wanted = Math.max(0, Math.min(head.numbers.length - 1, index));
    slider.value = String(wanted);
    readout.textContent = `layer ${head.numbers[wanted]} of ${head.count}, z ${heightOf(wanted).toFixed(3)} mm`;
    if (cursor) {
      const x = xOf(head.numbers[wanted]).toFixed(1);
      cursor.setAttribute("d", `M${x} 14V206`);
    }
    if (!quietly) document.dispatchEvent(new CustomEvent("sppm-cut", { detail: heightOf(wanted) }));
    draw();
  }

  const axis = chart ? { x0: +chart.dataset.x0, x1: +chart.dataset.x1, left: +chart.dataset.left, right: +chart.dataset.right } : null;
  const xOf = (n) => axis.left + ((n - axis.x0) / (axis.x1 - axis.x0)) * (axis.right - axis.left);
  const nearest = (n) => {
    let best = 0;
    head.numbers.forEach((m, i) => { if (Math.abs(m - n) < Math.abs(head.numbers[best] - n)) best = i; });
    return best;
  };
  if (chart) {
    cursor = document.createElementNS("http://www.w3.org/2000/svg", "path");
    cursor.setAttribute("class", "cursor");
    chart.append(cursor);
    chart.addEventListener("click", (event) => {
      const box = chart.getBoundingClientRect(), x = ((event.clientX - box.left) / box.width) * chart.viewBox.baseVal.width;
      show(nearest(axis.x0 + ((x - axis.left) / (axis.right - axis.left)) * (axis.x1 - axis.x0)));
    });
  }
  function stop() {
    clearInterval(timer);
    timer = 0;
    play.textContent = "▶";
  }
  play.addEventListener("click", () => {
    if (timer) return stop();
    play.textContent = "❚❚";
    timer = setInterval(() => show((wanted + 1) % head.numbers.length), 60);
  });
  slider.addEventListener("input", () => { stop(); show(+slider.value); });
  canvas.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1, PageUp: 10, PageDown: -10 }[event.key];
    if (step) { event.preventDefault(); stop(); show(wanted + step); }
  });
  canvas.addEventListener("pointermove", (event) => {
    const box = canvas.getBoundingClientRect();
    const x = head.origin_mm[0] + ((event.clientX - box.left) / box.width) * head.size[0] * head.pixel_mm[0];
    const y = head.origin_mm[1] + (1 - (event.clientY - box.top) / box.height) * head.size[1] * head.pixel_mm[1];
    byId("layer-caption").textContent = `x ${x.toFixed(2)} mm, y ${y.toFixed(2)} mm`;
  });
  document.addEventListener("sppm-height", (event) => show(nearest((event.detail - head.origin_mm[2]) / head.layer_mm - 0.5), true));
  byId("layer-still").hidden = true;
  byId("layer-caption").textContent = " ";
  canvas.hidden = byId("layer-controls").hidden = false;
  show(wanted, true);
}
