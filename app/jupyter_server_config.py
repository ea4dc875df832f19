"""How `make lab` starts JupyterLab: see facelab/widgets/server.py."""

import os

c = get_config()  # noqa: F821
c.ServerApp.allow_root = os.geteuid() == 0  # in a container one is root, and may be
c.ServerApp.kernel_websocket_connection_class = "facelab.widgets.server.NoDelayConnection"
