"""Commands in processes of their own, forked by one that has imported the library."""

import json
import re
import subprocess
import sys
from pathlib import Path


class Server:
    """Starts commands; each writes what it prints to the end of a log."""

    def __init__(self, folder, **environment):
        self.log_path, self.started, self.ended = folder / "log.txt", [], {}
        command = [sys.executable, str(Path(__file__).with_name("command_server.py"))]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        self.process = subprocess.Popen(command, **pipes, **environment)

    def close(self):
        self.process.stdin.close()
        self.process.wait()

    def start(self, *arguments, folder="."):
        line = json.dumps([[str(word) for word in arguments], str(self.log_path), str(folder)])
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()
        while not self.started:
            self._listen()
        return self.started.pop()

    def wait(self, number):
        """Return the exit status of a process when it ends; below 0 the signal that ended it."""
        while number not in self.ended:
            self._listen()
        return self.ended.pop(number)

    def _listen(self):
        number, said = self.process.stdout.readline().split()
        if said == "started":
            self.started.append(int(number))
        else:
            self.ended[int(number)] = int(said)

    def run(self, *arguments, folder="."):
        return self.wait(self.start(*arguments, folder=folder))

    def log(self):
        return self.log_path.read_text(errors="replace") if self.log_path.exists() else ""

    def tracebacks(self):
        """Return what the commands did not foresee: Python itself shows a Ctrl-C that came within a
        destructor."""
        shown = r"Exception ignored in: .*\nTraceback .*\n(?: .*\n)+KeyboardInterrupt"
        return re.findall("Traceback .*", re.sub(shown, "", self.log()))
