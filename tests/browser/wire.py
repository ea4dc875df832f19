"""A slow wire between page and server: a port that passes everything on, a moment later."""

import asyncio
import threading


class Wire:
    """Passes connections on to a port of this machine, each way delayed.

    Parameters
    ----------
    port : int
        Where the server listens.

    Attributes
    ----------
    port : int
        Where the wire listens.
    delay : float
        Seconds, one way; may be changed at any time.
    """

    def __init__(self, port):
        self.delay, self._to = 0.0, port
        self._loop, ready = asyncio.new_event_loop(), threading.Event()

        async def listen():
            self._server = await asyncio.start_server(self._connect, "127.0.0.1", 0)
            self.port = self._server.sockets[0].getsockname()[1]
            ready.set()

        self._loop.create_task(listen())
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        ready.wait()

    async def _connect(self, reader, writer):
        try:
            there = await asyncio.open_connection("127.0.0.1", self._to)
        except OSError:
            writer.close()
            return
        await asyncio.gather(self._pass(reader, there[1]), self._pass(there[0], writer))

    async def _pass(self, reader, writer):
        """All that comes in goes out in its order, each piece after the delay."""
        waiting = asyncio.Queue()

        async def send():
            while (piece := await waiting.get()) is not None:
                due, data = piece
                await asyncio.sleep(max(0.0, due - self._loop.time()))
                writer.write(data)
                await writer.drain()
            writer.close()

        sending = asyncio.create_task(send())
        try:
            while data := await reader.read(1 << 16):
                waiting.put_nowait((self._loop.time() + self.delay, data))
        except OSError:
            pass
        waiting.put_nowait(None)
        try:
            await sending
        except OSError:  # the other end has gone
            pass

    def close(self):
        """Cut all connections."""
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
