# SPDX-License-Identifier: Apache-2.0
"""What makes C++ types of .msg and .idl files (tools/messages): its output, its refusals with file, line and cause, and the CMake function
in a project of its own. What the types do is tested by test_messages."""
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import unittest

from common import SOURCE

GENERATE = [sys.executable, "-B", str(SOURCE / "tools/messages/generate.py")]
OWN = SOURCE / "tools/messages/interfaces"
TEST = SOURCE / "tests/unit/messages/interfaces"
GOLDEN = SOURCE / "tests/golden/messages"

# name of the file -> its text -> what is said of it, behind the file's name
MALFORMED = (
    ("p/msg/A.msg", "int32", ":1: 'int32' is no field: <type> <name>"),
    ("p/msg/A.msg", "\n# c\nint33 a\n", ":3: 'int33' is no type"),
    ("p/msg/A.msg", "Nothing a", ":1: there is no p/msg/Nothing.msg or .idl below"),
    ("p/msg/A.msg", "q/Nothing a", ":1: there is no q/msg/Nothing.msg or .idl below"),
    ("p/msg/A.msg", "A a", ": holds itself: p/msg/A holds p/msg/A"),
    ("p/msg/A.msg", "int32 A", ":1: 'A' is no name for a field"),
    ("p/msg/A.msg", "int32 a__b", ":1: 'a__b' is no name for a field"),
    ("p/msg/A.msg", "int32 a\nint8 a", ":2: 'a' is there twice"),
    ("p/msg/A.msg", "int32 LIMIT", ":1: 'LIMIT' is no name for a field: lower case, or a constant with = and its value"),
    ("p/msg/A.msg", "int8 LIMIT=128", ":1: 128 is beyond int8: -128 to 127"),
    ("p/msg/A.msg", "int8 LIMIT=much", ":1: 'much' is no int8"),
    ("p/msg/A.msg", "int8 limit=1", ":1: 'limit' is no name for a constant"),
    ("p/msg/A.msg", "int8[2] LIMIT=1", ":1: a constant cannot be of type int8[2]"),
    ("p/msg/A.msg", "uint8 a -1", ":1: -1 is beyond uint8: 0 to 255"),
    ("p/msg/A.msg", "bool a maybe", ":1: 'maybe' is no bool"),
    ("p/msg/A.msg", "float32 a 1..2", ":1: '1..2' is no float32"),
    ("p/msg/A.msg", "int8[2] a [1]", ":1: 1 default values for 2 elements"),
    ("p/msg/A.msg", "int8[<=1] a [1, 2]", ":1: 2 default values for at most 1 elements"),
    ("p/msg/A.msg", "int8[] a 1", ":1: the default value 1 is a single value, not a list in [ ]"),
    ("p/msg/A.msg", 'string<=2 a "abc"', ":1: the default value has more than 2 bytes"),
    ("p/msg/A.msg", 'string a "abc', ':1: "abc has a quotation mark without its pair'),
    ("p/msg/A.msg", "int8[0] a", ":1: 0 is not from 1 to"),
    ("p/msg/A.msg", "int8[99999999999] a", ":1: 99999999999 is not from 1 to"),
    ("p/msg/A.msg", "int8[-1] a", ":1: 'int8[-1]' is no type"),
    ("p/msg/A.msg", "int8<=4 a", ":1: 'int8<=4': only string and wstring have a bound without [ ]"),
    ("p/msg/A.msg", b"string a \xff", ": is not UTF-8: invalid start byte at byte 9"),
    ("p/msg/a.msg", "int8 a", ": is not called <package>/msg/<Type>"),
    ("P/msg/A.msg", "int8 a", ": is not called <package>/msg/<Type>"),
    ("p/msg/A.idl", "module p { module msg { struct A { long a; }; };", ":1: 'the end of the file' where"),
    ("p/msg/A.idl", "module p { module msg { struct B { long a; }; }; };", ":1: 'p::msg::B': a file has one struct"),
    ("p/msg/A.idl", "// nothing", ":1: there is no struct A in the module p::msg"),
    ("p/msg/A.idl", "module p { module msg {\nunion A switch (long) {}; }; };", ":2: 'union' is nothing that ROS 2 has in messages"),
    ("p/msg/A.idl", "module p { module msg { struct A {\n@key long a; }; }; };", ":2: @key changes what goes over the wire"),
    ("p/msg/A.idl", "module p { module msg { struct A {\n\nlong double a; }; }; };", ":3: 'long double' is nothing that can be sent"),
    ("p/msg/A.idl", "module p { module msg { struct A { sequence<sequence<long>> a; }; }; };", ":1: a sequence of sequences"),
    ("p/msg/A.idl", "module p { module msg { struct A { long a[2][3]; }; }; };", ":1: an array of sequences or arrays"),
    ("p/msg/A.idl", "module p { module msg { struct A { long a[0]; }; }; };", ":1: 0 is not from 1 to"),
    ("p/msg/A.idl", "module p { const long X = 1; };", ":1: 'X' is outside of the module A_Constants"),
    ("p/msg/A.idl", "module p { module msg { struct A { @default(value=300) octet a; }; }; };", ":1: 300 is beyond byte: 0 to 255"),
    ("p/msg/A.idl", "module p { module msg { struct A { int8 a }; }; };", ":1: '}' where ';' is expected"),
)


class Messages(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)

    def generate(self, *arguments):
        return subprocess.run([*GENERATE, *map(str, arguments)], capture_output=True, text=True, timeout=60)

    def make(self, *files, roots=(TEST, OWN)):
        done = self.generate(*(word for root in roots for word in ("--root", root)), "--out", self.folder / "out", "make", *files)
        self.assertEqual(done.returncode, 0, done.stderr)
        return self.folder / "out"

    def test_headers_are_the_golden_ones(self):
        out = self.make("test_msgs/msg/Part.msg", "test_msgs/msg/Lane.idl")
        for golden in sorted(GOLDEN.glob("*.h.txt")):
            made = (out / "test_msgs/msg" / golden.stem).read_text()
            if os.environ.get("XAUTO_UPDATE_GOLDEN"):
                golden.write_text(made)
            self.assertEqual(made, golden.read_text(), golden.name)

    def test_what_is_malformed_is_named_with_file_line_and_cause(self):
        for name, text, message in MALFORMED:
            path = self.folder / "in" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(text if isinstance(text, bytes) else text.encode())
            done = self.generate("--root", self.folder / "in", "list", name)
            path.unlink()
            self.assertEqual(done.returncode, 1, (name, text))
            self.assertTrue(done.stderr.startswith(str(path) + message), (text, done.stderr))
            self.assertEqual(done.stderr.count("\n"), 1, done.stderr)

    def test_no_bytes_make_it_stumble(self):
        """A message or types, and never a traceback: each file of ours, cut and with each of some bytes in it."""
        lane = (TEST / "test_msgs/msg/Lane.idl").read_text()
        kinds = (TEST / "test_msgs/msg/AllKinds.msg").read_text()
        sys.path.insert(0, str(SOURCE / "tools/messages"))
        self.addCleanup(sys.path.pop, 0)
        from idl_file import read_idl
        from interface import Message, Refused
        from msg_file import read_msg
        for text, read, name in ((lane, read_idl, "Lane"), (kinds, read_msg, "AllKinds")):
            for i in range(0, len(text), 3):
                for wrong in (text[:i], text[:i] + "[" + text[i:], text[:i] + '"' + text[i:], text[:i] + "9<" + text[i + 1:], text[i:]):
                    try:
                        read(wrong, Message("test_msgs", name, pathlib.Path(name)))
                    except Refused:
                        pass

    def test_all_of_our_interfaces_are_made(self):
        files = [p.relative_to(OWN) for p in sorted(OWN.rglob("*.msg"))]
        self.assertGreater(len(files), 100)
        out = self.make(*files, roots=[OWN])
        self.assertEqual(len(list(out.rglob("*.h"))), len(files))

    def test_cmake_function_makes_what_a_target_needs_once(self):
        project = self.folder / "project"
        shutil.copytree(TEST / "test_msgs", project / "test_msgs")
        (project / "main.cc").write_text('#include <sensor_msgs/msg/image.h>\n#include <test_msgs/msg/lane.h>\n'
                                         'static_assert(xauto::Codec<test_msgs::msg::Lane>::kMaxBytes == 99);\n'
                                         'int main() { return static_cast<int>(sensor_msgs::msg::Image{}.height); }\n')
        lists = project / "CMakeLists.txt"
        lists.write_text(f"""cmake_minimum_required(VERSION 3.18)
project(p LANGUAGES CXX)
set(CMAKE_CXX_STANDARD 20)
set(XAUTO_MESSAGES {SOURCE}/tools/messages)
include({SOURCE}/cmake/messages.cmake)
add_executable(p main.cc)
target_include_directories(p PRIVATE {SOURCE}/include)
xauto_add_messages(p test_msgs/msg/Lane.idl MAX_BYTES 99)
xauto_add_messages(p sensor_msgs/msg/Image.msg)
""")
        cmake = ["cmake", "-G", "Ninja", "-S", str(project), "-B", str(project / "build")]
        done = subprocess.run(cmake, capture_output=True, text=True, timeout=120)
        self.assertEqual(done.returncode, 0, done.stderr)
        done = subprocess.run(["cmake", "--build", str(project / "build")], capture_output=True, text=True, timeout=250)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        (project / "test_msgs/msg/Lane.idl").write_text("struct")
        done = subprocess.run(cmake, capture_output=True, text=True, timeout=120)
        self.assertNotEqual(done.returncode, 0)
        self.assertIn("test_msgs/msg/Lane.idl:1: ", done.stderr)


if __name__ == "__main__":
    unittest.main()
