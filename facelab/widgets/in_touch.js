const TELL = "facelab-tell"; // asks all parts of a page to tell the kernel what they keep back
const newName = () => crypto.randomUUID?.() ?? String(Math.random()); // the first over https and on this machine only

// anywidget gives a model of the page two seconds to start. A page that is busy drawing may need
// more, and then anywidget keeps all that the kernel says from that model for ever. So such a model
// listens to the kernel itself, and asks for what it has missed.
async function stayInTouch({ model }) {
  const manager = model.widget_manager;
  drawOnceMore(manager);
  const own = await manager.get_model(model.get("own_id"));
  const nothing = { content: { data: {} } };
  own._handle_comm_msg(nothing).catch(() => {
    const ofWidgets = Object.getPrototypeOf(own.constructor.prototype);
    own.comm.on_msg((message) => ofWidgets._handle_comm_msg.call(own, message));
    own.comm.send({ method: "request_state" });
  });
}

// A page that is loaded anew gets its models from the kernel. JupyterLab waits two seconds for each
// that an output shows, does not look again at their end, and then says for ever that there is none.
// So a little later the outputs that say so, though their model has come, are drawn once more.
async function drawOnceMore(manager) {
  if (!manager.context || manager.facelabWaits) return;
  manager.facelabWaits = true;
  if (!manager.restoredStatus) await new Promise((done) => manager.restored.connect(done));
  await new Promise((done) => setTimeout(done, 2500));
  const bare = [...document.querySelectorAll(".jp-OutputArea-output.jupyter-widgets:not(:has(*))")];
  if (!bare.some((output) => output.textContent.includes("model not found"))) return;
  for (const { outputs } of manager.context.model.cells) {
    for (let k = 0; k < (outputs?.length ?? 0); k++) {
      const id = outputs.get(k).data["application/vnd.jupyter.widget-view+json"]?.model_id;
      if (!id || !manager.has_model(id)) continue;
      const { views } = await manager.get_model(id);
      if (!Object.keys(views ?? {}).length) outputs.set(k, outputs.get(k).toJSON());
    }
  }
}
