"""Mutants that no test can kill, by module: what is changed, and why nothing can be seen of it."""

NONE_FOR_NONE = "any negative number stands for none"
STRICT = "a strict zip of what is of one length"
ONE_BY_ONE = "what odd frames go through gives the same for all, only slower"
ANNOTATIONS = "an import for annotations, which are not evaluated"
WOKEN = "set by the frame that wakes the engine, read after one"
LATER = "stamps of the open tick and later are put off to what they are"
NO_GAP = "where there is no gap, of whole nanoseconds, nothing is asked of it"
SOONER = "a string takes its ticks in before it must: only slower"
BLOCKS = "ticks are put together when a string takes them, if not before"
INSTANT = "at that very instant of a clock"
LET_GO = "Python closes a socket that nobody holds any more"
BEHIND = "room behind the last field, where the kernel writes nothing"
NEVER_NONE = "the kernel gives an error where it has no datagram, never 0"
READ_AT = "whoever reads a block says where it lies"
MORE_BINS = "one empty bin more than there are groups, never looked up"
INFINITE = "of an infinite value the sign is asked, which no bound near zero changes"
SET_BY_EXCERPT = "what `excerpt` gives, it sets"
FIRST_US = "no sample is of the first microseconds of 1970"
ANOTHER_LINE = "a line that is taken with the mark of another one does not fit, and is read by itself"
LOOKED_FOR = "in which blocks blank lines are looked for, which is seen in time alone"
OTHER_DRAWS = "other draws of the same distribution"
TWO_LEFT = "without 29 bits two filters are left, which every limit allows"
A_SECOND = "a step is one second"
MORE_PARTS = "a version has more parts than that"
BILLIONTH = "a billionth of a wait, which no clock shows"

EQUIVALENT: dict[str, dict[str, str]] = {
    "bms_gateway/bus/pace.py": {
        ": 10000000  ->  10000001": "a nanosecond of a bucket of ten milliseconds: no token more",
        "Pacer.offer: True  ->  False": STRICT,
        "Pacer.head: now_ns > self._at_ns  ->  now_ns >= self._at_ns": "at one instant nothing is added either way",
        "Pacer.done: 0  ->  1": "a nanosecond, at bus time 0 alone: what is done was given by `head`",
    },
    "bms_gateway/frames/peers.py": {
        "Peers.__init__: 1  ->  2": MORE_BINS,
        "Peers.others: 1  ->  2": MORE_BINS,
        "Peers.of_any: 1  ->  2": MORE_BINS,
    },
    "bms_gateway/frames/repeats.py": {
        "Repeats.freezes: share ** run < HARDLY  ->  share ** run <= HARDLY": (
            "no share to a whole power is just 10⁻⁹ in floating point: 0.1⁹ is above it"
        ),
    },
    "bms_gateway/frames/guard.py": {
        "Guard.__init__: 1  ->  2": NONE_FOR_NONE,
        "Guard._judge: step < 1.01 * PROOF_K  ->  step <= 1.01 * PROOF_K": (
            "0.0505 K is 0.05 K with room for rounding; no signal steps by just that"
        ),
        "Guard._judge: usable & ~upset  ->  usable | ~upset": (
            "differs for samples that are usable and upset: there the cause remembered is the one of this sample"
        ),
        "_rounds: np.arange(len(order)) - start.repeat(np.diff(np.append(start, len(order))))  ->  "
        "np.arange(len(order)) + start.repeat(np.diff(np.append(start, len(order))))": (
            "the samples of a channel still go into rounds in their order; rounds are more, some of them empty"
        ),
        "_rounds: 1  ->  2  #4": "one empty round more",
    },
    "bms_gateway/engine/stamps.py": {
        "Clock.straighten: steps.min() >= 0  ->  steps.min() > 0": ONE_BY_ONE,
        "Clock.straighten: 0  ->  1  #3": ONE_BY_ONE,
        "Clock.straighten: steps.max() <= AHEAD_NS  ->  steps.max() < AHEAD_NS": ONE_BY_ONE,
        "Clock._one_by_one: raw[0] + self.shift_ns  ->  raw[0] - self.shift_ns": "the shift is 0 before any frame",
        "Clock._one_by_one: 1  ->  2  #2": "the slice ends at the end of the batch",
        "Clock._one_by_one: break  ->  continue": "at the last frame of the batch",
    },
    "bms_gateway/engine/current.py": {
        "Current: 0  ->  1": "time of a sample that there is not: its value is NaN, and is asked first",
        "Current: 0  ->  1  #2": "time of a sample that there is not: its value is NaN whatever its age",
        "Current.update: 0.0  ->  1.0  #4": "a value of the weight 0; any number but NaN does",
        "Current.update: 0.0  ->  1.0  #6": "a voltage of the weight 0; any number but NaN does",
    },
    "bms_gateway/engine/backlog.py": {
        ": 60  ->  61": "the size of a block, which is seen in memory and time alone",
        "Backlog.__init__: 0  ->  1": "numbers of ticks may begin anywhere: all strings see the first tick",
        "Backlog.add: tick.square + tick.inlet  ->  tick.square - tick.inlet": (
            "whether both are finite: a difference tells as well as a sum"
        ),
        "Backlog.add: now + 1  ->  now - 1  #2": SOONER,
        "Backlog.add: self._next = int(self._due.min())  ->  pass": SOONER,
        "Backlog.add: if len(self._single) >= BLOCK:  ->  if not len(self._single) >= BLOCK:": BLOCKS,
        "Backlog.add: len(self._single) >= BLOCK  ->  len(self._single) > BLOCK": BLOCKS,
        "Backlog.add: self._stack()  ->  pass": BLOCKS,
        "Backlog._bring: since >= self._now  ->  since > self._now": "no block ends later: nothing is handed over",
        "Backlog._bring: b.end > since  ->  b.end >= since": "of a block that ends there no tick is left",
        "Backlog._stack: True  ->  False": STRICT,
        "Backlog._forget: b.end > self._least  ->  b.end >= self._least": "one block is kept longer, and not read",
    },
    "bms_gateway/engine/engine.py": {
        "Engine.__init__: self._heard = 0  ->  pass": WOKEN,
        "Engine.__init__: 0  ->  1": WOKEN,
        "Engine.__init__: 0  ->  1  #3": WOKEN,
        "Engine.__init__: 0  ->  1  #6": "losses are told in all: what was told last is not asked",
        "Engine.__init__: self.woken_ns = 0  ->  pass": WOKEN,
        "Engine.receive: self._tick_end is not None and int(frames.time_ns[0]) < self._tick_end  ->  "
        "self._tick_end is not None or int(frames.time_ns[0]) < self._tick_end": LATER,
        "Engine.receive: int(frames.time_ns[0]) < self._tick_end  ->  int(frames.time_ns[0]) <= self._tick_end": LATER,
        "Engine.receive: frames.time_ns.max() > now_ns  ->  frames.time_ns.max() >= now_ns": "what is of now stays so",
        "Engine.receive: self._deadline is not None and int(frames.time_ns[-1]) >= self._deadline  ->  "
        "self._deadline is not None or int(frames.time_ns[-1]) >= self._deadline": (
            "armed by the frames before; where no tick is over none is run, and all frames are kept"
        ),
        "Engine._wake: 0 <= start - self._tick_end <= AT_ONCE_NS  ->  0 < start - self._tick_end <= AT_ONCE_NS": NO_GAP,
        "Engine._wake: 0  ->  1": NO_GAP,
        "Engine._wake: start < self._tick_end  ->  start <= self._tick_end": NO_GAP,
        "Engine._tick: 1000000000.0  ->  1000000001.0": "six digits of it are shown",
        "Engine._counts: 0.0  ->  1.0": "of what was told last the time since the start is not asked",
        "Engine.__init__: 0.0  ->  1.0": "of what was told last the time since the start is not asked",
    },
    "bms_gateway/engine/broadcast.py": {
        "Broadcast.encode: True  ->  False": STRICT,
        "Broadcast.encode: True  ->  False  #2": STRICT,
        "Broadcast.encode: True  ->  False  #3": STRICT,
        "Broadcast.encode: True  ->  False  #4": STRICT,
    },
    "bms_gateway/engine/estimators.py": {
        "Estimators.__init__: True  ->  False": STRICT,
        "Estimators._step_group: True  ->  False": STRICT,
        "Estimators.restore: True  ->  False": STRICT,
        ": if TYPE_CHECKING:  ->  if not TYPE_CHECKING:": ANNOTATIONS,
    },
    "bms_gateway/engine/string_estimator.py": {
        "StringEstimator._as_kept: True  ->  False": STRICT,
    },
    "bms_gateway/engine/inputs.py": {
        "Inputs.__init__: True  ->  False": STRICT,
        "Inputs._integrate: 1  ->  2  #3": "every index below nought stands for no input",
        "Inputs._integrate: 2  ->  3": "one ampere to any power is one",
        "Inputs.__init__: 1  ->  2": "where an input more than there are would end, never looked up",
    },
    "bms_gateway/engine/group.py": {
        ": if TYPE_CHECKING:  ->  if not TYPE_CHECKING:": ANNOTATIONS,
    },
    "bms_gateway/engine/line.py": {
        "Line.update: True  ->  False": STRICT,
        "Line.at: p[0] - t - mean_x  ->  p[0] - t + mean_x  #2": "times what sums to zero over the readings",
        "Line.at: p[1] - mean_y  ->  p[1] + mean_y": "times what sums to zero over the readings",
    },
    "bms_gateway/engine/plausible.py": {
        "check_covariance: 0.0  ->  1.0  #3": "a positive one beside it makes the least no less negative",
        "check_parameters: True  ->  False": STRICT,
    },
    "bms_gateway/bus/receiver.py": {
        ": 1024  ->  1025": "room for one frame more in a call",
        ": ctypes.sizeof(ctypes.c_long) - 4 or 4  ->  ctypes.sizeof(ctypes.c_long) - 4 and 4": BEHIND,
        ": ctypes.sizeof(ctypes.c_long) - 4  ->  ctypes.sizeof(ctypes.c_long) + 4": BEHIND,
        ": 4  ->  5": BEHIND,
        ": 4  ->  5  #2": BEHIND,
        ": recvmmsg.argtypes = (ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_void_p)  ->  "
        "pass": "ctypes takes these arguments for the same without being told",
        ": recvmmsg.restype = ctypes.c_int  ->  pass": "what ctypes assumes",
        "Receiver.__init__: 1  ->  2": "any number but 0 switches an option on",
        "Receiver.__init__: 1  ->  2  #2": "any number but 0 switches an option on",
        "Receiver.take: (n := recvmmsg(self._sock.fileno(), self._messages, DEPTH, socket.MSG_DONTWAIT, None)) < 0"
        "  ->  "
        "(n := recvmmsg(self._sock.fileno(), self._messages, DEPTH, socket.MSG_DONTWAIT, None)) <= 0": NEVER_NONE,
        "Receiver.take: 0  ->  1": NEVER_NONE,
    },
    "bms_gateway/bus/socketcan.py": {
        "SocketCanPort.__init__: self._retry_at = self._down_at = 0.0  ->  pass": "set by each failure, read after one",
        "SocketCanPort.__init__: 0.0  ->  1.0  #2": "set by each failure, read after one",
        "SocketCanPort.now_ns: 1000000000.0  ->  1000000001.0": "a step of an hour is told with three more digits",
        "SocketCanPort.pump: wait > 0  ->  wait >= 0": "at that very instant: the caller comes again at once",
        "SocketCanPort._is_up: 0  ->  1": "the kernel writes the flags there, whatever they were",
    },
    "bms_gateway/bus/pythoncan.py": {
        ": if TYPE_CHECKING:  ->  if not TYPE_CHECKING:": ANNOTATIONS,
        "PythonCanPort.drain: break  ->  continue": "a failure takes the bus away, which ends the loop",
        "PythonCanPort.drain: abs(off) > AHEAD_S  ->  abs(off) >= AHEAD_S": "an hour to the last bit of a float",
        "PythonCanPort.pump: wait > 0  ->  wait >= 0": "at that very instant: the caller comes again at once",
    },
    "bms_gateway/bus/canframe.py": {
        ": 64  ->  65  #3": "a column more than any frame has",
        "to_batch: length.max() <= 8  ->  length.max() < 8": ONE_BY_ONE,
        "to_batch: int(np.bitwise_or.reduce(can_id)) & _NO_DATA  ->  "
        "int(np.bitwise_or.reduce(can_id)) | _NO_DATA": ONE_BY_ONE,
        "to_batch: 0  ->  1": ONE_BY_ONE,
        "to_batch: 64  ->  65  #2": "a column more than any frame has",
        "to_batch: length.min() < columns  ->  length.min() <= columns": "full frames keep all their bytes either way",
    },
    "bms_gateway/bus/message.py": {
        ": if TYPE_CHECKING:  ->  if not TYPE_CHECKING:": ANNOTATIONS,
        "to_batch: len(kept) < len(messages)  ->  len(kept) <= len(messages)": "nothing is counted where all are kept",
        "to_batch: 1  ->  2": "numpy finds the length of an axis for any negative number",
    },
    "bms_gateway/service/fit_process.py": {
        ": sys.version_info < (3, 11, 4)  ->  sys.version_info <= (3, 11, 4)": MORE_PARTS,
    },
    "bms_gateway/service/reread.py": {
        ": if TYPE_CHECKING:  ->  if not TYPE_CHECKING:": ANNOTATIONS,
        ": child.returncode < 0  ->  child.returncode <= 0": "asked where it is not 0",
        ": 0  ->  1  #2": "asked where it is not 0",
    },
    "bms_gateway/service/watch.py": {
        "Watch._kept: 0.0  ->  1.0": "no state is old after a second",
        "_Recent: 0  ->  1  #2": "set to 0 by the first update, before which nothing was counted",
    },
    "bms_gateway/service/saves.py": {
        "Saves.__init__: self._taken_s = 0.0  ->  pass": "set by each save, read after one",
        "Saves.__init__: 0.0  ->  1.0": "set by each save, read after one",
    },
    "bms_gateway/store/recent.py": {
        "Block: 0  ->  1": READ_AT,
        "Block: 0  ->  1  #2": READ_AT,
        "layout_of: True  ->  False": STRICT,
        "_unpacked: True  ->  False": STRICT,
        "_sorted: 1  ->  2": "numpy finds the length of an axis for any negative number",
        "_unsorted: 1  ->  2": "numpy finds the length of an axis for any negative number",
        "packed: 6  ->  7": "how hard it is packed; what is unpacked is the same",
        "_blocks: at < len(raw)  ->  at <= len(raw)": "behind the last byte nothing is found, nor damaged",
        "_blocks: further < 0  ->  further <= 0": "a further place lies behind this one, so it is never 0",
        "_blocks: 0  ->  1  #2": "a further place lies behind this one, so it is never 0",
    },
    "bms_gateway/store/trial.py": {
        "Trial.__init__: 0.0  ->  1.0": "asked after `begin`, which sets it, or a second after the boot",
        "Trial.alive: now_s - self.alive_s > HANG_S  ->  now_s - self.alive_s >= HANG_S": INSTANT,
        "Trial.noting: time.monotonic() - self.alive_s > HANG_S  ->  "
        "time.monotonic() - self.alive_s >= HANG_S": INSTANT,
        "Trial.noting: time.monotonic() - self.alive_s > HANG_S  ->  "
        "time.monotonic() - self.alive_s >= HANG_S  #2": INSTANT,
        ": 1  ->  2": NONE_FOR_NONE,
    },
    "bms_gateway/service/on_trial.py": {
        ": gateway.port.now_ns() - due < OVERDUE_NS  ->  gateway.port.now_ns() - due <= OVERDUE_NS": INSTANT,
    },
    "bms_gateway/service/http.py": {
        ": 16  ->  17": "how many wait in the kernel to be taken: one more or less",
        ": 0.01  ->  1.01": "a pause between two clients",
        ": 0.2  ->  1.2": "how old a page may be",
        ": 10.0  ->  11.0": "how soon an address that is taken is tried again",
        "MetricsServer: 1  ->  2": "any number but zero sets the option",
        "MetricsServer.answer: 1  ->  2  #2": "what follows is not looked at",
        "MetricsServer.answer: 1  ->  2  #4": "what follows is not looked at",
    },
    "bms_gateway/service/signals.py": {
        "End.now: True  ->  False": "the next call ends the process with all its threads",
        "Signals.listen.over: self._poke = _nothing  ->  pass": "the kernel ignores a signal that nothing handles",
        "Signals._open: True  ->  False": "the thread has ended when the process does, or `End` ends the process",
        "Signals._open: False  ->  True  #2": "a warning when the descriptor is full, which holds hundreds of signals",
        "Signals._open.close: ours.close()  ->  pass": LET_GO,
        "Signals._open.close: theirs.close()  ->  pass": LET_GO,
        "Signals._open.close: thread.join()  ->  pass": "the byte ends the thread a moment later",
    },
    "bms_gateway/store/files.py": {
        ": os.O_RDONLY | os.O_CLOEXEC  ->  os.O_RDONLY & os.O_CLOEXEC": "Python closes descriptors for children",
        ": 1  ->  2": "read in larger pieces",
        ": 20  ->  21": "read in larger pieces",
        "read_on: most > 0  ->  most >= 0": "nothing more is read when nothing more is wanted",
    },
    "bms_gateway/store/state.py": {
        ": 256  ->  257": "bytes of a head; ours has half as many, and a longer one is none of ours",
        "_read: 1  ->  2": "of what is too long one byte more is read",
        "_read: 1  ->  2  #2": "of what is too long one byte more is read",
        "_read: len(head) + 1 + size + 1 - len(start)  ->  len(head) + 1 + size + 1 + len(start)": "of what "
        "is too long up to half a kilobyte more is read",
        "_read: len(body) < size  ->  len(body) <= size": "they differ here",
    },
    "bms_gateway/store/requests.py": {
        "_write: 8  ->  9": "a longer name that nobody guesses",
    },
    "bms_gateway/store/rows.py": {
        "Excerpt: False  ->  True": SET_BY_EXCERPT,
        "Excerpt: 0  ->  1": SET_BY_EXCERPT,
        "Excerpt: 0  ->  1  #2": SET_BY_EXCERPT,
        "Excerpt.rows: -1  ->  1": FIRST_US,
        "Excerpt.rows: 1  ->  2": FIRST_US,
        "_rows: True  ->  False": STRICT,
    },
    "bms_gateway/bus/logfile.py": {
        "write_log: 6  ->  7": "more effort in packing: the same text is unpacked",
        "_nearest_file: 1  ->  2": "of two names the nearer one is told",
    },
    "bms_gateway/service/metrics.py": {
        "Page._shell: True  ->  False": STRICT,
        "_strings: 0  ->  1  #2": "a flag that is raised has at least level 1",
        "_ahead: True  ->  False": STRICT,
    },
    "bms_gateway/service/exposition.py": {
        "_number: value > 0  ->  value >= 0": INFINITE,
        "_number: 0  ->  1": INFINITE,
    },
    "bms_gateway/service/journal.py": {
        "Throttle.__init__: super().__init__()  ->  pass": "a name of a filter, which nobody asks for",
        "JournalHandler.close: super().close()  ->  pass": "logging holds its handlers weakly",
    },
    "bms_gateway/service/summary.py": {
        "_ahead: True  ->  False": STRICT,
        "_ahead: True  ->  False  #2": STRICT,
    },
    "bms_gateway/service/doctor.py": {
        "python_version: sys.version_info >= OLDEST  ->  sys.version_info > OLDEST": MORE_PARTS,
    },
    "bms_gateway/bus/sniff.py": {
        "_unpacked: 31  ->  32": "zlib then finds out by itself that it is gzip",
    },
    "bms_gateway/bus/virtual.py": {
        "VirtualPack.__init__: 96  ->  97": OTHER_DRAWS,
        "VirtualPack.segments: duration_s / STEP_S  ->  duration_s * STEP_S": A_SECOND,
        "VirtualPack.segments: k.astype(np.float64) * STEP_S  ->  k.astype(np.float64) / STEP_S": A_SECOND,
        "VirtualPack.segments: True  ->  False": STRICT,
        "VirtualPack.segments: len(time) - 1  ->  len(time) + 1": "slices end with their arrays",
        "VirtualPack.segments: real[:-1] * STEP_S  ->  real[:-1] / STEP_S": A_SECOND,
        "VirtualPack._inlet: w * time + self.phase  ->  w * time - self.phase": OTHER_DRAWS,
        "VirtualPack._start_state: self._inlet(string, np.zeros(1)) + rng.uniform(0.0, 8.0) + rng.normal(0.0, 0.5, n)"
        "  ->  self._inlet(string, np.zeros(1)) + rng.uniform(0.0, 8.0) - rng.normal(0.0, 0.5, n)": OTHER_DRAWS,
        "VirtualPack._start_state: surface + rng.uniform(0.0, 8.0) + rng.normal(0.0, 0.5, n)  ->  "
        "surface + rng.uniform(0.0, 8.0) - rng.normal(0.0, 0.5, n)": OTHER_DRAWS,
        "_truth: getattr(p, name) * np.exp(together + each)  ->  "
        "getattr(p, name) / np.exp(together + each)": OTHER_DRAWS,
        "_truth: together + each  ->  together - each": OTHER_DRAWS,
    },
    "bms_gateway/bus/filters.py": {
        "join_filters: dropped < 29  ->  dropped <= 29": TWO_LEFT,
        "join_filters: 29  ->  30": TWO_LEFT,
    },
    "bms_gateway/bus/traffic.py": {
        "Series.at: t >= self.time_s[-1]  ->  t > self.time_s[-1]": "at the last point the other condition holds",
        "Series.at: t <= self.time_s[-1]  ->  t < self.time_s[-1]": "at the last point the other condition holds",
        "Traffic.__init__: 202  ->  203": OTHER_DRAWS,
        "_cycle: 0  ->  1": "a nanosecond is less than the second that it is held against",
        "Traffic._load: 0  ->  1": "set again when the slots are spread",
        "Traffic._sample: value + self._noise_K * self._rng.standard_normal(len(t))  ->  "
        "value - self._noise_K * self._rng.standard_normal(len(t))": OTHER_DRAWS,
    },
    "bms_gateway/bus/blf.py": {
        "BoundedBlf.__init__: True  ->  False": "the first container begins with an object",
    },
    "bms_gateway/bus/foreign.py": {
        ": if TYPE_CHECKING:  ->  if not TYPE_CHECKING:": ANNOTATIONS,
    },
    "bms_gateway/bus/candump.py": {
        ": 32  ->  33": "blank bytes around a block, one more",
        ": 8  ->  9": "lines with a ninth layout of stamps are read by themselves or not: the same, only slower",
        ": 9  ->  10": LOOKED_FOR,
        ": 128  ->  129": "no digit has the high bit, whatever the others are",
        ": 16  ->  17": "the value of a single digit",
        ": 256  ->  257  #2": "no byte is 256",
        "parse_block: newline - start < SHORTEST  ->  newline - start <= SHORTEST": LOOKED_FOR,
        "parse_block: newline - start < SHORTEST  ->  newline - start > SHORTEST": LOOKED_FOR,
        "parse_block: not ((marks > start) & (marks < newline)).all()  ->  "
        "((marks > start) & (marks < newline)).all()": ANOTHER_LINE,
        "parse_block: (marks > start) & (marks < newline)  ->  (marks > start) | (marks < newline)": ANOTHER_LINE,
        "parse_block: marks > start  ->  marks >= start": ANOTHER_LINE,
        "parse_block: marks > start  ->  marks < start": ANOTHER_LINE,
        "parse_block: marks < newline  ->  marks <= newline": ANOTHER_LINE,
        "parse_block: marks < newline  ->  marks > newline": ANOTHER_LINE,
        "format_block: 3  ->  4  #2": "what is put there is written once more below",
        "format_block: 8  ->  9": "no CAN frame has nine bytes",
        "_filled: newline - 1  ->  newline + 1": "a blank line before another one may stay, and is passed over later",
        "_filled: 1  ->  2  #2": "the end of a line is blank",
        "_words: 7  ->  8": "the last word lies behind the block",
        "_number: digits <= 8  ->  digits < 8": "no digits in front are worth nothing",
        "_pairs: False  ->  True": "a copy more",
        "_pairs: 1  ->  2": NONE_FOR_NONE,
        "_stamps: break  ->  continue": "nothing is left for the other rounds either",
        "_ids: 1  ->  2": NONE_FOR_NONE,
        "_ids: 0  ->  1  #2": "both lie before every line",
        "_payloads: 16  ->  17": "an odd number of digits is refused by itself",
        "_payloads: 0  ->  1  #3": "of a payload that does not fit nothing is used",
        "_read_odd: newline > start  ->  newline >= start": "an empty line is passed over all the same",
        "_read_odd: 0  ->  1": "the identifier of a line that has none",
    },
    "bms_gateway/service/reporting.py": {
        ": if TYPE_CHECKING:  ->  if not TYPE_CHECKING:": ANNOTATIONS,
    },
    "bms_gateway/service/live.py": {
        "Gateway._feed: 1000000000.0  ->  1000000001.0": BILLIONTH,
    },
    "bms_gateway/service/turns.py": {
        "Turns.begin: 1000000000.0  ->  1000000001.0": BILLIONTH,
        "Turns.arm: 1000000000.0  ->  1000000001.0": BILLIONTH,
        "Turns.arm: self._timer = None  ->  pass": "a timer that is over or cancelled may be cancelled once more",
    },
    "bms_gateway/service/tally.py": {
        "Tally: 0  ->  1  #10": "no tick ends in the first nanosecond of 1970",
    },
    "bms_gateway/service/broker.py": {
        "Broker.__init__: self.line = ''  ->  pass": "set again before it is read",
        "Broker: self.told = None  ->  pass": "no line of status is STOPPED",
        "tls_context: context.minimum_version = ssl.TLSVersion.TLSv1_2  ->  pass": "the default of this Python",
        "Broker.cancel: self._loop is not None and self._task is not None  ->  "
        "self._loop is not None or self._task is not None": "both are set together",
        "Broker: loop.set_exception_handler(lambda _, context: log.debug('MQTT: in the client: %s', "
        "context['message']))  ->  pass": "a line for who looks for a fault, or asyncio's own",
    },
    "bms_gateway/bus/replay.py": {
        "SocketCanSender._send_one: now > give_up  ->  now >= give_up": INSTANT,
        "replay: 0  ->  1  #2": "set by the first frame",
        "replay: clock() - shown > SHOW_S  ->  clock() - shown >= SHOW_S": INSTANT,
    },
}
