"""A driver as users write one, run by the tests as a process of its own. It prints where it should not."""

from __future__ import annotations

import atexit
import os
import subprocess
import sys
import threading

from support import Lamp, SlowCamera, SlowNosepiece, TimedStage

from scopeservo_driver import protect_stdout, serve, serve_tcp


class ChattyStage(TimedStage):
    def motion(self) -> str:
        print("a library says hello")
        os.write(1, b"straight to file descriptor 1\n")
        # It would take the program's requests away if it were given the real standard input.
        subprocess.run(
            [sys.executable, "-c", "import sys; print('a child process says hello', sys.stdin.read())"], check=True
        )
        return super().motion()

    def stop(self) -> None:
        super().stop()
        print(f"stopped at {self.position()['x_um']:.1f}", file=sys.stderr)


def main() -> None:
    atexit.register(lambda: print("cleaned up", file=sys.stderr))
    devices = {"camera": SlowCamera(), "nosepiece": SlowNosepiece(), "light": Lamp()}
    if "--chatty" in sys.argv:
        protect_stdout()
        print("printed before serve was called")
        devices["stage"] = ChattyStage()
    else:
        devices["stage"] = TimedStage()
        devices["stage"].stop = lambda stop=devices["stage"].stop: (stop(), print("told to stop", file=sys.stderr))
    if "--hanging-thread" in sys.argv:
        threading.Thread(target=threading.Event().wait).start()
    if "--tcp" in sys.argv:
        host, secret = sys.argv[sys.argv.index("--tcp") + 1 :][:2]
        serve_tcp(**devices, name="example", host=host, port=0, secret=secret or None)
    serve(**devices, name="example")


if __name__ == "__main__":
    main()
