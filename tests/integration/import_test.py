# SPDX-License-Identifier: Apache-2.0
"""xauto import and xauto whatif as a user runs them: on the trace that LTTng made (tests/golden/ros2-trace), on CARET's
demo and trtexec's files (../shared/data, where they are), on an export of Nsight Systems as NVIDIA documents it, and on a
model of Amalthea (tests/golden/amalthea); and the program to fill in, compiled and run."""
import json
import pathlib
import sqlite3
import subprocess
import tempfile
import unittest

from common import BIN, SOURCE, XAUTO, xauto

MADE = SOURCE / "tests/golden/ros2-trace/made"
MODEL = SOURCE / "tests/golden/amalthea/fusion.amxmi"
DATA = SOURCE.parent / "shared/data"
CARET = DATA / "ros2-trace/caret-demo"
SANITIZED = any(word in pathlib.Path(XAUTO).read_bytes() for word in (b"__asan_init", b"__tsan_init"))


def without(library):
    """Whether this build lacks it."""
    return xauto("import", MADE, "--out", "/dev/null").stderr.count(f"without {library}") > 0


class InAFolder(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.at = pathlib.Path(folder.name)

    def good(self, *arguments, **more):
        done = xauto(*arguments, cwd=self.at, **more)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        return done.stdout


class Others(InAFolder):
    def export(self, name):
        process = 4711 << 24
        with sqlite3.connect(self.at / name) as database:
            database.executescript("""
                CREATE TABLE StringIds (id INTEGER PRIMARY KEY, value TEXT NOT NULL);
                CREATE TABLE NVTX_EVENTS (start INT NOT NULL, end INT, eventType INT NOT NULL, text TEXT, globalTid INT, textId INT);
                CREATE TABLE CUPTI_ACTIVITY_KIND_RUNTIME (start INT NOT NULL, end INT NOT NULL, eventClass INT NOT NULL,
                    globalTid INT, correlationId INT, nameId INT NOT NULL, returnValue INT NOT NULL);
                CREATE TABLE CUPTI_ACTIVITY_KIND_KERNEL (start INT NOT NULL, end INT NOT NULL, deviceId INT NOT NULL,
                    correlationId INT, globalPid INT);""")
            for k in range(30):
                at = k * 33_333_333
                database.execute("INSERT INTO NVTX_EVENTS VALUES (?, ?, 59, 'detect', ?, NULL)", (at, at + 1_000_000, process + 1))
                database.execute("INSERT INTO CUPTI_ACTIVITY_KIND_RUNTIME VALUES (?, ?, 0, ?, ?, 1, 0)",
                                 (at + 1000, at + 9000, process + 1, k + 1))
                database.execute("INSERT INTO CUPTI_ACTIVITY_KIND_KERNEL VALUES (?, ?, 0, ?, ?)",
                                 (at + 500_000, at + 6_000_000 + 1000 * k, k + 1, process))

    def test_an_export_of_nsight_systems_becomes_an_app_that_is_solved(self):
        self.export("report.sqlite")
        said = self.good("import", "report.sqlite", "--out", "app.json")
        for line in ("1 XNode of 30 ranges", "detect on gpu", "TODO"):
            self.assertIn(line, said)
        app = json.loads((self.at / "app.json").read_text())
        self.assertEqual((app["name"], app["sources"][0]["rate_hz"], app["xnodes"][0]["wcet_us"]), ("report", 30, {"gpu": 6029}))
        self.good("import", "--app", "app.json", "--ask", "--out", "b.json", stdin="20000\n\n" + '{"dla": 9000}\n')
        asked = json.loads((self.at / "b.json").read_text())
        self.assertEqual((asked["chains"][0]["deadline_us"], asked["xnodes"][0]["wcet_us"]["dla"]), (20000, 9000))
        self.good("solve", "--app", "b.json", "--platform", "small", "--time-limit", "1s", "--out", "policy.json")
        self.good("whatif", "b.json", "--time-limit", "1s", "--out", "page.html")
        (self.at / "cut.sqlite").write_bytes((self.at / "report.sqlite").read_bytes()[:-4096])
        cut = xauto("import", "cut.sqlite", "--out", "cut.json", cwd=self.at)
        self.assertIn("damaged", cut.stdout + cut.stderr)

    @unittest.skipIf("without Expat" in xauto("import", MODEL, "--out", "/dev/null").stderr, "built without Expat")
    def test_a_model_of_amalthea_becomes_app_and_platform(self):
        said = self.good("import", MODEL, "--out", "app.json", "--platform-out", "platform.json")
        self.assertIn("5 XNodes of 4 tasks and 6 runnables", said)
        platform = json.loads((self.at / "platform.json").read_text())
        self.assertEqual([x["id"] for x in platform["xpus"]], ["cpu0", "cpu1", "gpu0"])
        self.good("solve", "--app", "app.json", "--platform", "platform.json", "--time-limit", "1s", "--out", "policy.json")
        self.good("check", "--app", "app.json", "--platform", "platform.json", "--policy", "policy.json")

    def test_what_is_neither_is_refused_in_a_line(self):
        (self.at / "text").write_text("hello")
        (self.at / "a.amxmi").write_text('<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>')
        self.export("report.sqlite")
        for words, says in ((("import", "text", "--out", "b.json"), "nothing that is known"),
                            (("import", "a.amxmi", "--out", "b.json"), "DOCTYPE|Expat"),
                            (("import", "report.sqlite", "--architecture", "x", "--out", "b.json"), "ROS 2"),
                            (("import", "report.sqlite", "--out", "b.json", "--platform-out", "p.json"), "only a model")):
            done = xauto(*words, cwd=self.at)
            self.assertEqual(done.returncode, 2, words)
            self.assertRegex(done.stderr, says, words)


@unittest.skipIf(without("libbabeltrace2"), "built without libbabeltrace2")
class Import(InAFolder):
    def test_a_trace_of_lttng_becomes_an_app_that_is_solved(self):
        said = self.good("import", MADE, "--out", "app.json")
        for line in ("3 XNodes of 96 callbacks", "events were lost while", "ros2:of_tomorrow", "TODO"):
            self.assertIn(line, said)
        app = json.loads((self.at / "app.json").read_text())
        self.assertEqual({s["name"]: s.get("clock", "main") for s in app["sources"]},
                         {"camera": "camera", "ticker.timer/tick": "main"})
        self.good("solve", "--strict", "--app", "app.json", "--platform", "small", "--time-limit", "1s", "--out", "policy.json")
        self.good("check", "--app", "app.json", "--policy", "policy.json")

    def test_questions_are_asked_one_by_one_and_answers_checked(self):
        self.good("import", MADE, "--out", "app.json")
        asked = json.loads((self.at / "app.json").read_text())["todo"]
        first = next(n for n, todo in enumerate(t for t in asked if t.get("at")) if "deadline" in todo["what"])
        said = self.good("import", "--app", "app.json", "--ask", "--out", "b.json", stdin="\n" * first + "soon\n70000\n")
        self.assertIn("'soon'", said.replace('"soon"', "'soon'"))
        answered = json.loads((self.at / "b.json").read_text())
        self.assertEqual(len(answered["todo"]), len(asked) - 1)
        self.assertEqual([c.get("deadline_us") for c in answered["chains"]].count(70000), 1)

    @unittest.skipUnless(CARET.exists(), "no ../shared/data")
    def test_carets_demo_is_played_as_it_ran_and_gains(self):
        self.good("import", CARET, "--architecture", DATA / "ros2-trace/caret-demo-architecture.yaml", "--out", "app.json")
        told = json.loads(self.good("whatif", "app.json", "--json", "--out", "page.html"))
        trace, now, keys = told["chains"][0]["ways"]
        for key in ("p50_us", "max_us"):
            self.assertLess(abs(now[key] - trace[key]), trace[key] / 10, key)
            self.assertLess(keys[key], now[key], key)
        self.assertLessEqual(keys["max_us"], keys["claimed_us"])
        page = (self.at / "page.html").read_text()
        for part in ("is within 10 % of the trace", "as it runs now, played", "<svg", "What app.json does not know"):
            self.assertIn(part, page)
        # It agrees by its rules, and not by its times: another executor does not.
        other = json.loads((self.at / "app.json").read_text())
        other["seen"]["executors"][0].update(type="single_threaded", threads=1)
        (self.at / "other.json").write_text(json.dumps(other))
        told = json.loads(self.good("whatif", "other.json", "--json", "--time-limit", "1s"))
        self.assertGreater(told["chains"][0]["ways"][1]["p50_us"], 2 * trace["p50_us"])
        self.assertIn("is NOT within 10 % of the trace", told["verdict"][0])
        # A way more where the filter has a DLA, and one with two of them.
        told = json.loads(self.good("whatif", "app.json", "--json", "--time-limit", "1s", "--on", "filter_node.topic1=dla:0.5",
                                    "--more", "dla"))
        self.assertEqual(len(told["chains"][0]["ways"]), 5)
        self.assertTrue(any(b["what"].startswith("dla") for b in told["busy"]))
        # One of a group has a DLA, the other one not; and on a platform whose cores preempt.
        told = json.loads(self.good("whatif", "app.json", "--json", "--time-limit", "1s", "--platform", "large", "--on",
                                    "message_driven_node.drive=dla:0.5"))
        self.assertIn("none of it goes to dla before all can", " ".join(told["verdict"]))
        self.assertIn("may run one of it inside another", " ".join(told["verdict"]))

    def test_what_does_not_fit_is_refused_in_a_line(self):
        self.good("import", MADE, "--out", "app.json")
        for words, says in ((("whatif", "app.json", "--more", "dla"), "no XPU of this type"),
                            (("whatif", "app.json", "--on", "nobody=dla:2"), "no such XNode"),
                            (("whatif", "app.json", "--on", "ticker.timer=dla:fast"), "is not XNODE=TYPE:TIMES"),
                            (("import", "--out", "b.json"), "nothing to import"),
                            (("import", MADE), "nothing to write"),
                            (("import", self.at, "--out", "b.json"), "no LTTng trace"),
                            (("import", "--trtexec", "net=gpu", "--out", "b.json"), "is not NET=TYPE:FILE"),
                            (("import", "--trtexec", "net=gpu:app.json", "--out", "b.json"), "no JSON array")):
            done = xauto(*words, cwd=self.at)
            self.assertEqual(done.returncode, 2, words)
            self.assertIn(says, done.stderr, words)

    @unittest.skipUnless((DATA / "trtexec").exists(), "no ../shared/data")
    def test_trtexec_gives_implementations_and_stages(self):
        nets = [f"{net}=gpu:{DATA}/trtexec/{net}.timing.json" for net in ("resnet18", "mobilenet_v2")]
        said = self.good("import", "--trtexec", nets[0], "--trtexec", nets[1], "--layers",
                         f"resnet18={DATA}/trtexec/resnet18.profile.json", "--stages", "3", "--out", "nets.json")
        self.assertIn("of 300 inferences", said)
        app = json.loads((self.at / "nets.json").read_text())
        self.assertEqual([x["name"] for x in app["xnodes"]], ["resnet18.1", "resnet18.2", "resnet18.3", "mobilenet_v2"])
        # The stages are the whole again, but for rounding.
        longest = max(run["latencyMs"] for run in json.loads((DATA / "trtexec/resnet18.timing.json").read_text()))
        self.assertAlmostEqual(sum(x["wcet_us"]["gpu"] for x in app["xnodes"][:3]), 1000 * longest, delta=4)
        self.good("solve", "--app", "nets.json", "--platform", "small", "--time-limit", "1s", "--out", "policy.json")
        self.good("import", MADE, "--out", "app.json")
        self.good("import", "--app", "app.json", "--trtexec", f"front/worker.camera=gpu:{DATA}/trtexec/resnet18.timing.json",
                  "--out", "app.json")
        both = json.loads((self.at / "app.json").read_text())
        self.assertEqual({len(x["wcet_us"]) for x in both["xnodes"] if x["name"] == "front/worker.camera"}, {2})

    def test_the_program_to_fill_in_compiles_and_runs(self):
        self.good("import", MADE, "--cpp", "app")
        if not SANITIZED:  # else the library wants its runtime
            library = BIN.parent / "lib"
            built = subprocess.run(["c++", "-std=c++20", "-Wall", "-Wextra", "-Werror", "-I", SOURCE / "include", "main.cc", "-o",
                                    "program", "-L", library, "-lxauto", f"-Wl,-rpath,{library}"],
                                   cwd=self.at / "app", capture_output=True, text=True)
            self.assertEqual(built.returncode, 0, built.stderr)
            self.good("solve", "--app", "app/app.json", "--platform", "small", "--time-limit", "1s", "--out", "policy.json")
            self.good("run", "--app", "app/app.json", "--policy", "policy.json", "--emulate", "--activations", "40", "--json",
                      "--", "app/program")
        again = xauto("import", MADE, "--cpp", "app", cwd=self.at)
        self.assertEqual(again.returncode, 2)
        self.assertIn("main.cc already", again.stderr)


if __name__ == "__main__":
    unittest.main()
