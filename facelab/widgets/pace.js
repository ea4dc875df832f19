// Keeps sliders from telling the kernel where they are more often than it should hear it.

// A widget keeps its changes back while one is under way, and sends the last of them then.
// So a message counts as under way for as long as no other shall leave.
function pace(slider, every) {
  const send = slider.send_sync_message.bind(slider);
  slider.send_sync_message = (...told) => {
    slider._pending_msgs++;
    setTimeout(() => slider._handle_status({ content: { execution_state: "idle" } }), every);
    return send(...told);
  };
}

export default {
  async initialize({ model }) {
    stayInTouch({ model });
    const get = (id) => model.widget_manager.get_model(id);
    const every = model.get("every");
    const sliders = Promise.all(model.get("sliders").map(get));
    // the kernel asks to hear of it when nothing is kept back
    model.on("msg:custom", async ({ asked }) => {
      while ((await sliders).some((slider) => slider._msg_buffer !== null))
        await new Promise((done) => setTimeout(done, every));
      model.send({ asked });
    });
    for (const slider of await sliders) pace(slider, every);
  },
};
