"""A kernel connection without Nagle's algorithm: small messages leave at once.

A drag sends a few hundred bytes a move. As the server comes, the operating system holds such
messages back for up to 40 ms, waiting to fill a packet. `app/jupyter_server_config.py` names this
class; a lab started without it works, a little less smoothly.
"""

from jupyter_server.services.kernels.connection.channels import ZMQChannelsWebsocketConnection


class NoDelayConnection(ZMQChannelsWebsocketConnection):
    """Sends every message at once."""

    async def connect(self):
        """Switch the socket to no delay, then connect as usual."""
        self.websocket_handler.set_nodelay(True)
        return await super().connect()
