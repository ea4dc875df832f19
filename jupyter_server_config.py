"""How `make lab` starts JupyterLab: see facelab/widgets/server.py."""

c = get_config()  # noqa: F821
c.ServerApp.kernel_websocket_connection_class = "facelab.widgets.server.NoDelayConnection"
