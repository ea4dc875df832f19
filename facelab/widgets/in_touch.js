// anywidget gives a model of the page two seconds to start. A page that is busy drawing may need
// more, and then anywidget keeps all that the kernel says from that model for ever. So such a model
// listens to the kernel itself, and asks for what it has missed.
async function stayInTouch({ model }) {
  const own = await model.widget_manager.get_model(model.get("own_id"));
  const nothing = { content: { data: {} } };
  own._handle_comm_msg(nothing).catch(() => {
    const ofWidgets = Object.getPrototypeOf(own.constructor.prototype);
    own.comm.on_msg((message) => ofWidgets._handle_comm_msg.call(own, message));
    own.comm.send({ method: "request_state" });
  });
}
