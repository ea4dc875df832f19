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

const pause = (ms) => new Promise((done) => setTimeout(done, ms));

async function allTold(sliders, every) {
  while (sliders.some((slider) => slider._msg_buffer !== null)) await pause(every);
}

// Which of them the mouse takes hold of.
async function heldBy({ target }, sliders) {
  for (const slider of target.closest?.(".noUi-target") ? sliders : [])
    for (const { el } of await Promise.all(Object.values(slider.views ?? {})))
      if (el.contains(target)) return slider;
  return null;
}

export default {
  async initialize({ model }) {
    stayInTouch({ model });
    const every = model.get("every");
    const get = (id) => model.widget_manager.get_model(id);
    const found = Promise.all(model.get("sliders").map(get));
    model.on("msg:custom", async ({ asked }) => {
      await allTold(await found, every);
      model.send({ do: "told", asked });
    });
    const sliders = await found;
    for (const slider of sliders) pace(slider, every);
    if (!model.get("watches")) return;
    const ended = new AbortController();
    const { signal } = ended;
    document.addEventListener("pointerdown", async (event) => {
      const slider = await heldBy(event, sliders);
      if (!slider) return;
      const about = { slider: slider.model_id, name: newName() };
      model.send({ do: "hold", ...about });
      const over = new AbortController();
      const letGo = async () => {
        over.abort();
        await pause(0); // the slider hears of it after this
        await allTold([slider], every);
        model.send({ do: "let", ...about, index: slider.get("index") });
      };
      for (const name of ["pointerup", "pointercancel"])
        window.addEventListener(name, letGo, { signal: over.signal, capture: true });
    }, { signal, capture: true });
    return () => ended.abort();
  },
};
