// Keeps sliders from telling the kernel more than ten times a second where they are.

const EVERY = 100; // ms

// A widget keeps its changes back while one is under way, and sends the last of them then.
// So a message counts as under way for as long as no other shall leave.
function pace(slider) {
  const send = slider.send_sync_message.bind(slider);
  slider.send_sync_message = (...told) => {
    slider._pending_msgs++;
    setTimeout(() => slider._handle_status({ content: { execution_state: "idle" } }), EVERY);
    return send(...told);
  };
}

export default {
  async initialize({ model }) {
    stayInTouch({ model });
    const get = (id) => model.widget_manager.get_model(id);
    (await Promise.all(model.get("sliders").map(get))).forEach(pace);
  },
};
