// In the frame of a notebook: other data come from outside, and level and porosity go there.
started.then((live) => {
  const readout = byId("live-readout");
  const tell = () => parent.postMessage({ level: +readout.dataset.level, porosity: +readout.dataset.porosity }, "*");
  addEventListener("message", (event) => { if (live && event.source === parent && event.data.view) live.load(new Uint8Array(event.data.view)); });
  if (readout) new MutationObserver(tell).observe(readout, { attributes: true });
  if (live && readout) tell();
});
