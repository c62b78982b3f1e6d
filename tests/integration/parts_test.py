# SPDX-License-Identifier: Apache-2.0
"""An app over two and three computers, by `xauto run --part`: each host is a network namespace with a CLOCK_MONOTONIC of its own, and
between them is a wire that delays, reorders, doubles and drops (wire.py). The app's results depend on every message."""
import json
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import unittest

from common import SOURCE, TESTAPP, XAUTO, wait_for, xauto
from pftrace import Trace

PLUGIN = pathlib.Path(XAUTO).parent.parent / "lib/xauto/cyclonedds.so"
SHIFT = pathlib.Path(XAUTO).parent / "libclock_shift.so"
WIRE = SOURCE / "tests/integration/wire.py"
HOSTS = ("front", "rear", "third")
MEET = "10.77.0.1:7400"
DDS = ("<CycloneDDS><Domain id='any'><General><Interfaces><NetworkInterface name='eth0'/></Interfaces></General></Domain></CycloneDDS>")
XNODES = [("a1", "A", "cpu"), ("a2", "A", "npu"), ("b1", "B", "npu"), ("c1", "C", "cpu"), ("d1", "D", "cpu")]
ETHTOOL = """import array, fcntl, socket, struct, sys
for command in (0x17, 0x1f, 0x2c):  # tx checksums, TSO, GRO: what is not computed a wire cannot hand on
    value = array.array("B", struct.pack("II", command, 0))
    try:
        fcntl.ioctl(socket.socket(), 0x8946, struct.pack("16sP", sys.argv[1].encode(), value.buffer_info()[0]))
    except OSError:
        pass
"""


STRANGERS = """import os, socket, struct, sys, time
until, there = time.monotonic() + 20, []
while len(there) < 80 and time.monotonic() < until:
    try:
        one = socket.create_connection((sys.argv[1], int(sys.argv[2])), 5)
        # Silence; noise; a length that nobody has; a frame that is none; one of another kind.
        one.send((b"", os.urandom(5000), struct.pack("<I", 2**32 - 1), b"\\x02\\0\\0\\0{}", b"\\x10\\0\\0\\0" + b'{"is": "report"}')[len(there) % 5] or b"")
        there.append(one)
    except ConnectionRefusedError:
        time.sleep(0.1)
    except OSError:
        there.append(None)
print("there", flush=True)
time.sleep(60)
"""


def call(*words):
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True)
    assert done.returncode == 0, f"{words}: {done.stdout}{done.stderr}"
    return done.stdout


def why_not():
    """Empty: hosts can be made here."""
    if os.geteuid() != 0:
        return "only root makes network namespaces"
    if not PLUGIN.exists():
        return "the plug-in for DDS is not built"
    if any(shutil.which(tool) is None for tool in ("ip", "unshare", "nsenter")):
        return "ip, unshare or nsenter is missing"
    done = subprocess.run(["unshare", "--net", "--time", "--fork", "--monotonic", "1000", "ip", "link", "add", "xauto0", "type", "veth"],
                          capture_output=True, text=True)
    return "" if done.returncode == 0 else "no namespaces here: " + done.stderr.strip()


class Network:
    """Hosts, and the wire between them."""

    def __init__(self, count):
        self.hold = [self.space("--monotonic", str(5000 * n)) for n in range(count)]
        self.middle = self.space()
        for n, host in enumerate(self.hold):
            call(*self.into(self.middle), "ip", "link", "add", f"w{n}", "type", "veth", "peer", "name", "eth0", "netns", host.pid)
            call(*self.into(self.middle), "ip", "link", "set", f"w{n}", "up", "promisc", "on")
            call(*self.into(host), "ip", "address", "add", f"10.77.0.{n + 1}/24", "dev", "eth0")
            call(*self.into(host), sys.executable, "-c", ETHTOOL, "eth0")
            for link in ("lo", "eth0"):
                call(*self.into(host), "ip", "link", "set", link, "up")
            call(*self.into(host), "ip", "route", "add", "224.0.0.0/4", "dev", "eth0")
        self.wire = subprocess.Popen([*self.into(self.middle), sys.executable, str(WIRE), *(f"w{n}" for n in range(count))],
                                     stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.wire.stdout.readline() == "ready\n"

    @staticmethod
    def space(*flags):
        words = ["unshare", "--net", *(["--time", *flags] if flags else []), "--fork", "--kill-child", "sh", "-c", "echo $$; exec sleep infinity"]
        process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        process.unshare, process.pid = process.pid, int(process.stdout.readline())
        return process

    @staticmethod
    def into(space):
        words = ["nsenter", f"--net=/proc/{space.pid}/ns/net"]
        return [*words, f"--time=/proc/{space.pid}/ns/time"] if "--time" in space.args else words

    def on(self, host):
        return self.into(self.hold[HOSTS.index(host)])

    def rule(self, host, **rule):
        """For what this host sends."""
        self.wire.stdin.write(json.dumps({"from": HOSTS.index(host), **rule}) + "\n")
        self.wire.stdin.flush()
        assert self.wire.stdout.readline() == "ok\n"

    def end(self):
        self.wire.kill()
        self.wire.communicate()
        for space in (*self.hold, self.middle):
            os.kill(space.pid, signal.SIGKILL)
            os.waitpid(space.unshare, 0)
            space.stdout.close()
            space.returncode = 0


class Parts(unittest.TestCase):
    count = 2

    @classmethod
    def setUpClass(cls):
        cls.network = Network(cls.count)
        cls.addClassCleanup(cls.network.end)

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.at = pathlib.Path(folder.name)
        for n in range(self.count):
            self.network.rule(HOSTS[n], delay_ms=0, jitter_ms=0, drop=False, twice=False)

    def write(self, name, value):
        (self.at / name).write_text(json.dumps(value))

    def solve(self, pins, x_ms=60, period_ms=100, **more):
        """app.json, platform.json and p.json; X of each crossing is `x_ms`."""
        hosts = HOSTS[:self.count]
        self.write("app.json", {
            "schema": "xauto.app", "version": 3, "name": "testapp",
            "sources": [{"name": "src", "period_us": 1000 * period_ms, "jitter_us": 2000}],
            "xnodes": [{"name": x, "module": m, "wcet_us": {t: 5000}, **({"source": "src"} if x in ("a1", "b1", "d1") else {})}
                       for x, m, t in XNODES],
            "edges": [["a1", "a2"], ["a2", "c1"], ["b1", "c1"]],
            "modules": [{"name": m, "host": h} for m, h in pins.items()], **more})
        self.write("platform.json", {
            "schema": "xauto.platform", "version": 1, "name": "test",
            "hosts": [{"name": h, "rate_ppm": 50} for h in hosts],
            "links": [{"from": g, "to": h, "base_us": 1000 * x_ms} for g in hosts for h in hosts if g != h],
            "xpus": [x for h in hosts for x in ({"id": f"{h}.cpu0", "type": "cpu", "host": h}, {"id": f"{h}.npu0", "type": "npu", "host": h})]})
        done = xauto("solve", "--app", "app.json", "--platform", "platform.json", "--max-evaluations", 200, "--out", "p.json", cwd=self.at)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        return json.loads((self.at / "p.json").read_text())

    def start(self, host, activations=30, limit="30s", tai_ms=None, before=(), more=(), fault=()):
        words = [*before, XAUTO, "run", "--app", "app.json", "--platform", "platform.json", "--policy", "p.json", "--emulate",
                 "--activations", activations, "--part", host, "--meet", MEET, "--meet-limit", limit, "--out", f"{host}.json", *more,
                 "--", TESTAPP, f"{host}.out", *fault, "emulated", 1000]
        return self.spawn(host, words, {"LD_PRELOAD": str(SHIFT), "XAUTO_TEST_TAI_MS": str(tai_ms)} if tai_ms else {})

    def spawn(self, host, words, environment={}):
        log = open(self.at / f"{host}.log", "a")
        self.addCleanup(log.close)
        process = subprocess.Popen([str(word) for word in (*self.network.on(host), *words)], cwd=self.at, stdout=log, stderr=log, start_new_session=True,
                                   env={**os.environ, "CYCLONEDDS_URI": DDS, "ROS_DOMAIN_ID": "77", **environment})

        def end():
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        self.addCleanup(end)
        return process

    def said(self, host):
        return (self.at / f"{host}.log").read_text()

    def ended(self, host, process, status=0):
        self.assertEqual(process.wait(timeout=60), status, self.said(host))
        return json.loads((self.at / f"{host}.json").read_text())["runs"][0]

    def results(self, host):
        """{topic: {release: value}}"""
        lines = [line.split() for line in (self.at / f"{host}.out").read_text().splitlines()]
        return {topic: {int(k): value for t, k, value in lines if t == topic} for topic in {line[0] for line in lines}}

    def expected(self, releases):
        """What the app computes on one machine, of each release."""
        done = subprocess.run([XAUTO, "run", "--app", "app.json", "--platform", "platform.json", "--policy", "p.json", "--emulate", "--lockstep",
                               "--activations", str(releases), "--", TESTAPP, "one.out", "emulated", "100"], cwd=self.at, capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
        return self.results("one")["c"]

    def kinds(self, run):
        return {one["kind"]: one["count"] for one in run["claims"]["assumptions"]}

    def run_all(self, **keywords):
        """One run of all hosts to its end: the report of the first."""
        processes = {host: self.start(host, **keywords) for host in reversed(HOSTS[:self.count])}
        return {host: self.ended(host, process) for host, process in processes.items()}

    def kept(self, what):
        """A machine that stood still is nobody's fault: three times in a row it does not."""
        for _ in range(3):
            reports = self.run_all()
            if self.kinds(reports["front"]).get("crossing_lost", 0) == 0:
                return reports
        self.fail(f"{what}: messages were lost, three times: {self.said('rear')}{self.said('front')}")

    def check_results(self, reports, host, releases=30):
        self.assertEqual(self.results(host)["c"], self.expected(releases))
        front = reports["front"]
        self.assertTrue(front["complete"], front)
        self.assertEqual({m["name"]: m["activations"] for m in front["modules"]}, dict.fromkeys("ABCD", releases))
        self.assertNotEqual(front["claims"]["verdict"], "exceeded", front)  # nothing was broken, and yet

    def check_rest(self, report, host, releases):
        """After a death: what came out is right, the last release is among it, and who hears nobody lost nothing."""
        known, done = self.expected(releases), self.results(host)["c"]
        self.assertIn(releases - 1, done)
        self.assertTrue(all(known[k] == value for k, value in done.items()))
        self.assertEqual({m["name"]: m["activations"] for m in report["modules"]}["D"], releases)

    def threads(self, process):
        """{name: {(policy, priority)}} of the threads of this part's processes."""
        found = {}
        for thread in pathlib.Path("/proc").glob("[0-9]*/task/[0-9]*"):
            try:
                if os.getsid(int(thread.parts[2])) == process.pid:
                    tid = int(thread.name)
                    found.setdefault((thread / "comm").read_text().strip(), set()).add((os.sched_getscheduler(tid), os.sched_getparam(tid).sched_priority))
            except (ProcessLookupError, FileNotFoundError):
                pass
        return found

    def until(self, host, text):
        wait_for(text, lambda: text in self.said(host))


CHAINS = [{"name": "c", "from": "src", "to": "c1"}, {"name": "d", "from": "src", "to": "d1"}]
TWO = {"A": "front", "B": "rear", "C": "rear", "D": "front"}
BACK = {"A": "rear", "B": "front", "C": "front", "D": "rear"}


class Two(Parts):
    def test_while_x_is_kept_each_result_is_that_of_one_machine(self):
        self.solve(TWO)
        self.network.rule("front", delay_ms=5, jitter_ms=20, twice=True)  # overtaken, and doubled
        self.check_results(self.kept("X is kept"), "rear")

    def test_x_that_is_a_tenth_too_small_is_found(self):
        self.network.rule("front", delay_ms=110)
        self.solve(TWO, x_ms=100, period_ms=250)
        front = self.run_all(activations=10)["front"]
        self.assertGreaterEqual(self.kinds(front)["crossing_lost"], 9)  # all but what a stall hides
        self.assertIn("from 'front' to 'rear'", " ".join(front["claims"]["broken"]))
        self.assertNotEqual(front["claims"]["verdict"], "kept")
        self.assertEqual({m["name"]: m["activations"] for m in front["modules"]}["D"], 10)  # the rest goes on
        self.assertIn("XNode 'a2' was not here, from 'front' to 'rear'", self.said("rear"))

    def test_what_is_lost_on_the_way_is_named_and_the_rest_goes_on(self):
        self.solve(BACK)
        rear = self.start("rear", activations=40)
        front = self.start("front", activations=40)
        time.sleep(3)  # wherever that is in the run: it takes 4 s, and begins after 2 s or more
        self.network.rule("rear", drop=True)
        self.until("front", "XNode 'a2' was not here, from 'rear' to 'front'")
        self.network.rule("rear", drop=False)
        report = self.ended("front", front)
        self.ended("rear", rear)
        lost = self.kinds(report)["crossing_lost"]
        self.assertTrue(0 < lost <= 40, lost)
        done = {m["name"]: m["activations"] for m in report["modules"]}
        self.assertEqual((done["A"], done["B"], done["D"]), (40, 40, 40))
        self.assertEqual(done["C"], 40 - lost)
        known = self.expected(40)
        self.assertTrue(all(known[k] == value for k, value in self.results("front")["c"].items()))

    def test_a_part_that_is_killed_joins_again(self):
        self.solve(TWO)
        front = self.start("front", activations=80)
        for times in range(3):
            rear = self.start("rear", activations=80)
            if times == 2:
                break
            time.sleep(2.5 if times == 0 else 1.5)
            os.killpg(rear.pid, signal.SIGKILL)
            wait_for("it is named", lambda: self.said("front").count("part 'rear' has gone") == times + 1)
        report = self.ended("front", front)
        self.ended("rear", rear)
        self.assertEqual(self.kinds(report)["part_gone"], 2)
        self.assertIn("part 'rear' was gone 2 times", " ".join(report["claims"]["broken"]))
        self.check_rest(report, "rear", 80)

    def test_so_does_the_first_one(self):
        self.solve(BACK)
        rear = self.start("rear", activations=70)
        front = self.start("front", activations=70)
        time.sleep(3.5)
        os.killpg(front.pid, signal.SIGKILL)
        self.until("rear", "part 'front' has gone")
        front = self.start("front", activations=70)
        report = self.ended("front", front)
        self.assertIn("part 'front' was gone 1 time", " ".join(self.ended("rear", rear)["claims"]["broken"]))
        self.check_rest(report, "front", 70)

    def test_clocks_that_are_too_far_apart_are_refused_at_once(self):
        self.solve(TWO)
        front = self.start("front")
        self.assertEqual(self.start("rear", tai_ms=-70).wait(timeout=30), 2)
        self.assertRegex(self.said("rear"), "clocks of 'rear' and 'front' are at least [67][0-9][.][0-9]+ ms apart")
        self.ended("rear", self.start("rear"))
        self.ended("front", front)

    def test_a_clock_that_is_off_by_less_is_part_of_x(self):
        """Behind by 50 ms of X = 60 ms, and 20 ms on the way: what rear sends is late by the clock of front."""
        self.network.rule("rear", delay_ms=20)
        self.solve(BACK)
        front, rear = self.start("front", activations=10), self.start("rear", activations=10, tai_ms=-50)
        self.ended("rear", rear)
        crossing, = self.ended("front", front)["crossings"]
        self.assertEqual((crossing["from"], crossing["to"]), ("rear", "front"))
        self.assertGreaterEqual(crossing["lost"], 8, crossing)  # all but what a stall hides

    def test_what_is_seen_of_it(self):
        """Threads, `top` and `monitor` meanwhile, and both traces as one timeline. Rear may give no priorities, and its clock is 20 ms behind."""
        self.solve(TWO, chains=CHAINS)
        self.network.rule("front", delay_ms=5)
        no_rights = ("setpriv", "--bounding-set=-sys_nice", "--inh-caps=-sys_nice", "prlimit", "--rtprio=0:0")
        rear = self.start("rear", activations=60, tai_ms=-20, before=no_rights, more=("--trace-out", "rear.pftrace"))
        front = self.start("front", activations=60, more=("--trace-out", "front.pftrace"))
        dds = {"recv", "dq.user", "dq.builtins", "tev", "xauto/dds"}
        for process, kind in ((front, (os.SCHED_FIFO, 1)), (rear, (os.SCHED_OTHER, 0))):
            wait_for("DDS's threads", lambda: dds <= self.threads(process).keys())
            threads = self.threads(process)
            self.assertEqual({name: threads[name] for name in dds}, dict.fromkeys(dds, {kind}))
        workers = {one for name, all_of in self.threads(front).items() if "@" in name for one in all_of}
        self.assertTrue(workers and all(policy == os.SCHED_FIFO and priority > 1 for policy, priority in workers), workers)
        self.assertIn("what crosses to other hosts has no priority", self.said("rear"))
        self.see_losses("front", "rear")
        reports = {"front": self.ended("front", front), "rear": self.ended("rear", rear)}
        self.assertRegex(" ".join(reports["front"]["notes"]), "'rear': .*what crosses to other hosts has no priority")
        self.see_timeline(20)

    def look(self, host, *words):
        done = subprocess.run([*self.network.on(host), XAUTO, *words, "--interval", "50ms"], capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
        return done.stdout

    def see_losses(self, sender, reader):
        """`top` and `monitor` on the reader's host name the link."""
        def run():
            runs = json.loads(self.look(reader, "top", "--once", "--json"))["runs"]
            return runs[0] if runs and runs[0].get("crossings") else None
        wait_for("it runs", lambda: (run() or {"releases": 0})["releases"] > 5)
        self.network.rule(sender, drop=True)
        wait_for("top says that some are lost", lambda: (run() or {"crossings": [{"lost": 0}]})["crossings"][0]["lost"] > 1)
        self.network.rule(sender, drop=False)
        crossing, = run()["crossings"]
        self.assertEqual((run()["host"], crossing["xnode"], crossing["from"], crossing["to"]), (reader, "a2", sender, reader))
        self.assertGreater(crossing["messages"], 0)
        self.assertRegex(self.look(reader, "top", "--once"), f"the part of host {reader}(.|\n)*a2 from {sender} ")
        labels = f'xnode="a2",from="{sender}",to="{reader}"'
        self.assertRegex(self.look(reader, "monitor"), f"xauto_crossing_lost_total{{[^}}]*{labels}}} [1-9]")
        self.assertRegex(self.look(reader, "monitor"), f'xauto_run_info{{[^}}]*host="{reader}"')
        statuses = {s["name"]: s for s in json.loads(self.look(reader, "monitor", "--json"))["status"]}
        self.assertGreater(int(statuses[f"xauto/testapp@{reader}: a2 from {sender} to {reader}"]["values"]["lost"]), 0)
        self.see_its_own("front", {"A", "D"}, "d", "c", "rear")
        self.see_its_own("rear", {"B", "C"}, "c", "d", "front")

    def see_its_own(self, host, modules, chain, other, ends_on):
        """What a part cannot know of is no zero: a chain that ends elsewhere, modules and XPUs of another host."""
        run, = json.loads(self.look(host, "top", "--once", "--json"))["runs"]
        self.assertEqual({m["name"] for m in run["modules"]}, modules)
        self.assertEqual([c["name"] for c in run["chains"]], [chain])
        self.assertEqual(run["chains_elsewhere"], [{"name": other, "host": ends_on}])
        text = self.look(host, "top", "--once")
        rows = [line.split(maxsplit=1) for line in text.splitlines() if line.startswith(f"  {other} ")]
        self.assertEqual(rows, [[other, f"ends on host {ends_on}"]], text)
        page = self.look(host, "monitor")
        self.assertEqual(set(re.findall('chain="([^"]*)"', page)), {chain})
        self.assertEqual(set(re.findall('module="([^"]*)"', page)), modules)
        self.assertEqual({x.split(".")[0] for x in re.findall('xpu="([^"]*)"', page)}, {host})
        names = {s["name"].split(": ")[1] for s in json.loads(self.look(host, "monitor", "--json"))["status"]}
        self.assertEqual({n for n in names if n.startswith(("chain", "module"))}, {f"chain {chain}", *(f"module {m}" for m in modules)})

    def see_timeline(self, apart_ms):
        """Both files, one behind the other: a group per host, and arrows that go back by no more than the clocks are apart."""
        traces = {host: Trace((self.at / f"{host}.pftrace").read_bytes()) for host in HOSTS[:2]}
        for host, trace in traces.items():
            self.assertTrue(trace.title.startswith(f"host {host}: "), trace.title)
            self.assertEqual({s.track.split("/")[1].split(".")[0] for s in trace.on("run", "run")}, {host})
        self.assertFalse(traces["front"].path.keys() & traces["rear"].path.keys())  # tracks stay apart
        across = 1 << 63
        begins = {flow: s for s in traces["front"].on("run") for flow in s.flows_out if flow >= across}
        ends = {flow: s for s in traces["rear"].on("run") for flow in s.flows_in if flow >= across}
        self.assertLessEqual(ends.keys(), begins.keys())  # what was lost has no arrow's end
        self.assertGreater(len(ends), 20)
        for flow, taken in ends.items():
            sent = begins[flow]
            self.assertEqual((sent.name, taken.name, sent.args["release"]), ("a2", "c1", taken.args["release"]))
            self.assertGreaterEqual(taken.begin - sent.end, -1e6 * (apart_ms + 1), (sent, taken))
            self.assertLess(taken.begin - sent.end, 1e9)

    def test_the_dump_of_a_miss_has_what_came_from_other_hosts(self):
        self.solve(TWO, chains=[{**CHAINS[0], "deadline_us": 95_000}, CHAINS[1]])
        policy = json.loads((self.at / "p.json").read_text())
        rear = self.start("rear", more=("--trace-out", "rear.pftrace"), fault=("hang", "C", 20, 300))
        front = self.start("front", more=("--trace-out", "front.pftrace"))
        rear.wait(timeout=60), front.wait(timeout=60)
        dump = Trace((self.at / "rear.miss-1.pftrace").read_bytes())
        self.assertTrue(dump.title.startswith("host rear: "), dump.title)
        self.assertFalse([s.name for s in dump.slices if "INCOMPLETE" in s.name])
        key, = next(x["key_us"] for x in policy["xnodes"] if x["name"] == "a2")
        taken = {s.args["release"]: s for s in dump.on("run") if s.name == "c1" and "messages" in s.args}
        self.assertIn(20, taken)
        sent = {flow: s for s in Trace((self.at / "front.pftrace").read_bytes()).on("run") for flow in s.flows_out}
        for release, job in taken.items():
            self.assertEqual(job.args["messages"], f"a2 {release} of host front, key {key} us, X 60000 us")
            across, = (flow for flow in job.flows_in if flow >> 63)
            self.assertEqual((sent[across].name, sent[across].args["release"]), ("a2", release))

    def test_who_is_missing_is_named(self):
        self.solve(TWO)
        self.start("front", limit="1s").wait(timeout=30)
        self.assertIn("nobody came from host 'rear' within 1 s", self.said("front"))
        self.start("rear", limit="1s").wait(timeout=30)
        self.assertIn("start the part of the platform's first host, 'front'", self.said("rear"))

    def test_other_files_are_refused(self):
        self.solve(TWO)
        front = self.start("front")
        rear = self.start("rear", activations=31)
        self.assertEqual(rear.wait(timeout=30), 2)
        self.assertIn("has another app, platform, policy", self.said("rear"))
        front.send_signal(signal.SIGINT)
        self.assertEqual(front.wait(timeout=30), 1)
        self.assertIn("told to stop before all parts were there", self.said("front"))


    def test_strangers_at_the_door_keep_nobody_out(self):
        self.solve(TWO)
        front = self.start("front", activations=10)
        strangers = subprocess.Popen([*self.network.on("rear"), sys.executable, "-c", STRANGERS, *MEET.split(":")], stdout=subprocess.PIPE, text=True)
        self.addCleanup(strangers.communicate)
        self.addCleanup(strangers.kill)
        self.assertEqual(strangers.stdout.readline(), "there\n")
        rear = self.start("rear", activations=10)
        self.assertTrue(self.ended("front", front)["complete"])
        self.ended("rear", rear)

    def test_the_page_s_commands(self):
        """docs/several-machines.md: solve, check, graph, explain and a part on each host, as they stand there, but for the address and the end."""
        page = (SOURCE / "docs/several-machines.md").read_text()
        commands = re.findall(r"^    (xauto (?:solve|check|graph|explain|run) .*)$", page, re.MULTILINE)
        self.assertEqual([c.split()[1] for c in commands], ["solve", "check", "graph", "explain", "run", "run"])
        self.solve(TWO)
        (self.at / "platform.json").rename(self.at / "orins.json")
        processes = []
        for command in commands:
            words = command.replace("10.0.0.1:7400", MEET).replace("--activations 0", "--duration 2s").replace("10s", "1s").split()
            words[0] = XAUTO
            if "--part" not in words:
                done = subprocess.run(words, cwd=self.at, capture_output=True, text=True)
                self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
                continue
            host = words[words.index("--part") + 1]
            words[words.index("--"):] = ["--emulate", "--out", f"{host}.json", "--", TESTAPP, f"{host}.out", "emulated", "1000"]
            processes.append((host, self.spawn(host, words)))
        for host, process in processes:
            self.assertTrue(self.ended(host, process)["complete"])
        self.assertEqual(len(self.results("rear")["c"]), 20)
        picture = (self.at / "two-hosts.svg").read_text()
        self.assertRegex(picture, "(?s)host front, .*host rear, .*X 60 ms")


    def test_the_driving_case_with_samples_and_several_rates(self):
        app = json.loads((SOURCE / "examples/driving/rates.json").read_text())
        for module in app["modules"]:
            module |= {"host": {"LD": "rear", "RCD": "rear", "CTL": "front"}.get(module["name"], "front")}
        platform = json.loads((SOURCE / "examples/driving/two-hosts.json").read_text())
        for link in platform["links"]:
            link["base_us"] = 25_000  # of 33 ms
        self.write("app.json", app)
        self.write("platform.json", platform)
        done = xauto("solve", "--app", "app.json", "--platform", "platform.json", "--max-evaluations", 200, "--out", "p.json", cwd=self.at)
        self.assertTrue((self.at / "p.json").exists(), done.stdout + done.stderr)
        parts = {host: self.spawn(host, [XAUTO, "run", "--app", "app.json", "--platform", "platform.json", "--policy", "p.json", "--emulate",
                                         "--duration", "3s", "--part", host, "--meet", MEET, "--out", f"{host}.json", "--",
                                         str(pathlib.Path(XAUTO).parent / "driving-rates")]) for host in ("rear", "front")}
        for process in parts.values():
            process.wait(timeout=60)  # 1 where this machine is too slow for its emulated XPUs
        report = json.loads((self.at / "front.json").read_text())["runs"][0]
        self.assertTrue(report["complete"], self.said("front"))
        counts = {c["xnode"]: c for c in report["crossings"]}
        # Cameras at 30 Hz, LD at 10 or 30 Hz: all that is due is here, or lost and counted.
        for xnode, releases in (("rcd.post", (90,)), ("ld.post", (30, 90))):
            c = counts[xnode]
            done = {m["name"]: m["activations"] + m["failed"] + m["dropped"] for m in report["modules"]}[xnode.split(".")[0].upper()]
            self.assertIn(done, releases)
            self.assertLessEqual(c["messages"] + c["lost"], done)
            self.assertGreater(c["messages"], 0)
            self.assertEqual((c["twice"], c["refused"], c["other_runs"]), (0, 0, 0), c)
        self.assertGreater(next(c for c in report["chains"] if c["name"] == "lane")["results"], 0)


class Three(Parts):
    count = 3

    def test_a_host_without_work_has_no_part(self):
        self.solve({"A": "third", "B": "rear", "C": "rear", "D": "rear"})
        self.assertEqual(self.start("front").wait(timeout=30), 2)
        self.assertIn("no XNode on host 'front'", self.said("front"))

    def test_three_hosts(self):
        self.solve({"A": "front", "B": "rear", "C": "third", "D": "rear"})
        self.network.rule("rear", jitter_ms=10)
        self.check_results(self.kept("X is kept"), "third")


def main():
    if why := why_not():
        print(f"SKIP: {why}")
        return 77
    if len(sys.argv) > 1:
        unittest.main(verbosity=2)
    # They wait more than they compute: two at a time, each on a network of its own.
    names = sorted(test.id().removeprefix("__main__.") for suite in unittest.defaultTestLoader.loadTestsFromModule(sys.modules["__main__"])
                   for test in suite)
    halves = [subprocess.Popen([sys.executable, __file__, *names[half::2]]) for half in (0, 1)]
    return max(process.wait() for process in halves)


if __name__ == "__main__":
    sys.exit(main())
