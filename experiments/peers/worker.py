"""A process for each number of threads: most packages read it once, when they are loaded."""
import contextlib
import multiprocessing
import os

CORES = sorted(os.sched_getaffinity(0))


class Worker:
    """Calls `job(threads, ...)` in a process of its own that may use `threads` cores, and idles in between.

    It is held to the last of the cores, because not every package listens to the variables (those with TBB do not).
    What it starts itself is held to the same.
    """

    def __init__(self, threads, job):
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, threads, job), daemon=True)
        with _limited(threads):
            self.process.start()
        theirs.close()

    def call(self, *arguments):
        self.pipe.send(arguments)
        return self.pipe.recv()

    def close(self):
        self.pipe.close()
        self.process.join()


def workers(thread_counts, job):
    """One worker for each number of threads; by default one thread and all."""
    counts = sorted(set(thread_counts or [1, len(CORES)]))
    return {count: Worker(count, job) for count in counts}


def rotated(items, turn):
    """From turn to turn another one is first."""
    items = list(items)
    return items[turn % len(items) :] + items[: turn % len(items)]


@contextlib.contextmanager
def _limited(threads):
    names = [f"{library}_NUM_THREADS" for library in ("OMP", "OPENBLAS", "MKL", "NUMBA", "RAYON")]
    before = {name: os.environ.get(name) for name in names}
    os.environ.update({name: str(threads) for name in names})
    os.sched_setaffinity(0, CORES[-threads:])
    try:
        yield
    finally:
        os.sched_setaffinity(0, CORES)
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def _serve(pipe, threads, job):
    with contextlib.suppress(EOFError):
        while True:
            pipe.send(job(threads, *pipe.recv()))
