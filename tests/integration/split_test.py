# SPDX-License-Identifier: Apache-2.0
"""xauto split as a user runs it: nets written here and, where they could be fetched, real ones (scripts/fetch-onnx.sh). A
second opinion (onnx_file.faults) and, where it is there, ONNX Runtime say that parts are the whole."""
import json
import pathlib
import subprocess
import tempfile
import unittest

import onnx_file as onnx
from common import BIN, SOURCE, xauto

RUNTIME = (BIN / "xauto-onnxcheck").exists()
NETS = sorted((SOURCE / "build/onnx/nets").glob("*.onnx"), key=lambda p: p.stat().st_size)[:3]


class Split(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.at = pathlib.Path(folder.name)
        (self.at / "net.onnx").write_bytes(onnx.residual(5))

    def good(self, *arguments):
        done = xauto(*arguments, cwd=self.at)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        return done.stdout

    def parts(self, folder, net="net"):
        return [p.read_bytes() for p in sorted((self.at / folder).glob(f"{net}.*.onnx"), key=lambda p: int(p.suffixes[-2][1:]))]

    def layers(self, name, scale):
        nodes = onnx.read((self.at / "net.onnx").read_bytes())[7][0][1]
        layers = [{"count": 3}] + [{"name": onnx.name(n, 3), "averageMs": scale * (i % 4 + 1)} for i, n in enumerate(nodes[1:])]
        (self.at / name).write_text(json.dumps(layers))

    def test_parts_compose_to_the_whole(self):
        said = self.good("split", "net.onnx", "--at", "3", "--out", "parts")
        parts = self.parts("parts")
        self.assertEqual(len(parts), 4)
        self.assertEqual(onnx.faults((self.at / "net.onnx").read_bytes(), parts), [])
        self.assertIn("checked by ONNX Runtime" if RUNTIME else "NOT CHECKED", said)
        app = json.loads((self.at / "parts/app.json").read_text())
        self.assertEqual([x["name"] for x in app["xnodes"]], ["net.1", "net.2", "net.3", "net.4"])
        self.assertEqual(app["edges"], [["net.1", "net.2"], ["net.2", "net.3"], ["net.3", "net.4"]])
        self.good("import", "--app", "parts/app.json", "--ask", "--out", "asked.json")

    def test_the_second_opinion_finds_faults(self):
        self.good("split", "net.onnx", "--at", "2", "--out", "parts")
        whole, parts = (self.at / "net.onnx").read_bytes(), self.parts("parts")
        seeded = {"no part makes": parts[:2], "is in 2 parts": parts[:1] + parts, "nothing before it makes": parts[::-1],
                  "is not the whole's": [parts[0].replace(b"Relu", b"Rela")] + parts[1:],
                  "which is not there": [p.replace(b"B\x02w0", b"B\x02v0") for p in parts]}
        for says, changed in seeded.items():
            self.assertIn(says, " ".join(onnx.faults(whole, changed)), says)

    @unittest.skipUnless(RUNTIME, "no ONNX Runtime")
    def test_onnx_runtime_finds_faults(self):
        self.good("split", "net.onnx", "--at", "2", "--out", "parts")
        files = [self.at / f"parts/net.{p}.onnx" for p in (1, 2, 3)]
        check = lambda: subprocess.run([BIN / "xauto-onnxcheck", self.at / "net.onnx", *files], capture_output=True, text=True)
        self.assertEqual(check().returncode, 0)
        whole = files[1].read_bytes()
        files[1].write_bytes(whole.replace(b'"\x04Relu', b'"\x04Tanh', 1))  # its op_type
        done = check()
        self.assertEqual(done.returncode, 1)
        self.assertIn("differs", done.stderr)
        files[1].write_bytes(whole[:-5])
        self.assertEqual(check().returncode, 1)

    def test_the_solver_picks_among_cuts_and_neighbours_are_joined(self):
        self.layers("gpu.json", 1)
        self.layers("dla.json", 0.9)
        arguments = ("split", "net.onnx", "--at", "4", "--layers", "gpu=gpu.json", "--layers", "dla=dla.json")
        self.good(*arguments, "--out", "parts")
        app = json.loads((self.at / "parts/app.json").read_text())
        self.assertEqual({len(x["wcet_us"]) for x in app["xnodes"]}, {2})
        nodes = json.loads((self.at / "gpu.json").read_text())[1:]
        self.assertAlmostEqual(sum(x["wcet_us"]["gpu"] for x in app["xnodes"]), sum(1000 * n["averageMs"] for n in nodes), delta=5)
        self.good("solve", "--app", "parts/app.json", "--platform", "small", "--time-limit", "1s", "--pin", "net.1=gpu0",
                  "--pin", "net.2=gpu0", "--pin", "net.3=dla0", "--pin", "net.4=dla0", "--pin", "net.5=gpu0", "--out", "policy.json")
        said = self.good(*arguments, "--policy", "policy.json", "--out", "joined")
        self.assertIn("5 parts are 3 by the policy: on gpu0, dla0, gpu0", said)
        self.assertEqual(onnx.faults((self.at / "net.onnx").read_bytes(), self.parts("joined")), [])
        self.assertEqual(len(self.parts("joined")), 3)
        self.good("solve", "--app", "joined/app.json", "--platform", "small", "--time-limit", "1s", "--out", "policy.json")

    def test_a_cut_is_named_by_its_tensor(self):
        told = json.loads(self.good("split", "net.onnx", "--at", "a1", "--at", "m3", "--out", "parts", "--json"))
        self.assertEqual([p["inputs"] for p in told["parts"]], [["x"], ["a1"], ["a2", "m3"]])
        self.assertEqual([p["outputs"] for p in told["parts"]], [["a1", "early"], ["a2", "m3"], ["y"]])

    def test_tensors_in_other_files_come_along(self):
        entry = onnx.field(1, "location") + onnx.field(2, "w.bin")
        tensor = onnx.field(1, 4) + onnx.field(2, 1) + onnx.field(8, "w") + onnx.field(13, entry) + onnx.field(14, 1)
        nodes = [onnx.node("Add", ["x", "w"], ["a"]), onnx.node("Relu", ["a"], ["y"])]
        (self.at / "far.onnx").write_bytes(onnx.model(nodes, [onnx.info("x", [4])], [onnx.info("y", [4])], [tensor]))
        done = xauto("split", "far.onnx", "--at", "1", "--out", "parts", cwd=self.at)
        self.assertIn("w.bin", done.stderr)
        (self.at / "w.bin").write_bytes(bytes(16))
        said = self.good("split", "far.onnx", "--at", "1", "--out", "parts")
        self.assertEqual((self.at / "parts/w.bin").read_bytes(), bytes(16))
        if RUNTIME:
            self.assertIn("checked by ONNX Runtime", said)

    def test_what_does_not_fit_is_refused_in_a_line(self):
        (self.at / "none.onnx").write_text("no model")
        (self.at / "other.json").write_text('[{"name": "other", "averageMs": 1}]')
        for words, says in ((("none.onnx", "--at", "1", "--out", "p"), "no ONNX model"),
                            (("missing.onnx", "--at", "1", "--out", "p"), "cannot be opened"),
                            (("net.onnx", "--at", "40", "--out", "p"), "places to be cut, and not 40"),
                            (("net.onnx", "--at", "0", "--out", "p"), "no number of cuts"),
                            (("net.onnx", "--at", "nobody", "--out", "p"), "no tensor behind which"),
                            (("net.onnx", "--at", "1"), "where parts go"),
                            (("net.onnx", "--at", "1", "--out", "p", "--layers", "gpu=other.json"), "names a node"),
                            (("net.onnx", "--at", "1", "--out", "p", "--policy", "other.json"), "has no XNode")):
            done = xauto("split", *words, cwd=self.at)
            self.assertEqual(done.returncode, 2, words)
            self.assertIn(says, done.stderr, words)

    @unittest.skipUnless(NETS, "no nets: scripts/fetch-onnx.sh")
    def test_real_nets_are_cut(self):
        for net in NETS:
            said = self.good("split", net, "--at", "3", "--tensors", "4", "--out", net.stem)
            self.assertEqual(onnx.faults(net.read_bytes(), self.parts(net.stem, net.stem)), [], net.name)
            if RUNTIME:
                self.assertIn("checked by ONNX Runtime", said, net.name)


if __name__ == "__main__":
    unittest.main()
