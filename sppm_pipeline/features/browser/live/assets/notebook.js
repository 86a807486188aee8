// A widget of notebooks: sliders whose values Python gets, and the live view in a frame of its own.
export default {
  render({ model, el }) {
    const frame = document.createElement("iframe"), message = document.createElement("p");
    frame.setAttribute("sandbox", "allow-scripts");
    frame.title = "live view";
    Object.assign(frame.style, { border: "0", width: "100%", maxWidth: "680px", height: "540px" });
    let timer = 0;
    for (const [name, low, high, value, step] of model.get("sliders")) {
      const label = document.createElement("label"), input = document.createElement("input"), output = document.createElement("output");
      Object.assign(input, { type: "range", min: low, max: high, step: step || "any" });
      input.value = String(value);
      output.textContent = String(value);
      label.style.cssText = "display: flex; gap: 8px; align-items: center; max-width: 680px; font: 14px system-ui, sans-serif";
      input.style.flex = "1";
      input.addEventListener("input", () => {
        output.textContent = String(+(+input.value).toPrecision(4));
        clearTimeout(timer); // Python is asked when the hand rests
        timer = setTimeout(() => { model.set("values", { ...model.get("values"), [name]: +input.value }); model.save_changes(); }, 150);
      });
      label.append(`${name} `, input, output);
      el.append(label);
    }
    el.append(frame, message);
    const said = () => { message.textContent = model.get("message"); };
    const sent = () => {
      const view = model.get("view"), bytes = new Uint8Array(view.buffer, view.byteOffset, view.byteLength);
      frame.contentWindow.postMessage({ view: bytes.slice() }, "*");
    };
    const heard = (event) => {
      if (event.source !== frame.contentWindow) return;
      model.set("level", event.data.level);
      model.set("porosity", event.data.porosity);
      model.save_changes();
    };
    addEventListener("message", heard);
    model.on("change:view", sent);
    model.on("change:message", said);
    frame.srcdoc = model.get("page");
    said();
    return () => { removeEventListener("message", heard); model.off("change:view", sent); model.off("change:message", said); };
  },
};
