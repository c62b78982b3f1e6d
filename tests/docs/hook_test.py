# SPDX-License-Identifier: Apache-2.0
"""The pre-commit hook and the length of Markdown lines, in a repository that is made for it."""
import pathlib
import shutil
import subprocess
import tempfile
import unittest

SOURCE = pathlib.Path(__file__).resolve().parents[2]
GOOD = "// SPDX-License-Identifier: Apache-2.0\nint f();\n"


class Hook(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.root = pathlib.Path(folder.name)
        shutil.copytree(SOURCE / "scripts", self.root / "scripts", ignore=shutil.ignore_patterns("vm"))
        shutil.copy(SOURCE / ".clang-format", self.root)
        self.git("init", "-q")
        self.git("add", ".clang-format")

    def git(self, *arguments):
        subprocess.run(["git", *arguments], cwd=self.root, check=True, capture_output=True)

    def stage(self, path, text):
        file = self.root / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        self.git("add", path)

    def hook(self):
        done = subprocess.run(["scripts/hooks/pre-commit"], cwd=self.root, capture_output=True, text=True)
        return done.returncode, done.stdout + done.stderr

    def test_good_files_pass(self):
        self.stage("lib/base/a.h", GOOD)
        self.stage("a page.md", "# A page\n")
        self.assertEqual(self.hook(), (0, ""))

    def test_a_long_line_of_a_page(self):
        self.stage("page.md", "word " * 30 + "word\n")
        status, said = self.hook()
        self.assertEqual(status, 1)
        self.assertIn("page.md:1: 154 columns", said)

    def test_no_licence(self):
        self.stage("a.sh", "#!/bin/sh\n")
        status, said = self.hook()
        self.assertEqual(status, 1)
        self.assertIn("a.sh: no SPDX line", said)

    def test_blanks_at_the_end(self):
        self.stage("a.txt", "text \n")
        self.assertEqual(self.hook()[0], 1)

    @unittest.skipUnless(shutil.which("clang-format"), "no clang-format here")
    def test_layout_of_what_is_staged(self):
        self.stage("lib/base/a.h", GOOD.replace("int f", "int   f"))
        (self.root / "lib/base/a.h").write_text(GOOD)  # mended, and not staged
        status, said = self.hook()
        self.assertEqual(status, 1)
        self.assertIn("layout", said)
        self.git("add", "lib/base/a.h")
        self.assertEqual(self.hook()[0], 0)


if __name__ == "__main__":
    unittest.main()
