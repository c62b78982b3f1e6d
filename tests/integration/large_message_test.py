# SPDX-License-Identifier: Apache-2.0
"""A message that would overflow the stack of whoever makes it is refused by the compiler, wherever the API takes
messages, and in words that name the way out. Without that the app crashes when it starts."""
import os
import subprocess
import unittest

import common

# What takes or holds messages, each with a type of its own.
PLACES = ["app.add_source(TOPIC, 1ms, [](std::uint64_t) { return T{}; });",
          "app.add_source(TOPIC, 1ms, [](std::uint64_t) { return T{}; }, [](const T&, std::uint64_t) { return false; });",
          "(void)app.add_source(TOPIC, xauto::Pushed{1ms});",
          "app.on_message(TOPIC, [](const T&, std::uint64_t) {});",
          "module.add_input_topic(TOPIC);",
          "module.add_sampled_topic(TOPIC);",
          "module.add_output_topic(TOPIC, [](State&) { return T{}; });",
          "module.add_output_topic(TOPIC, [](State&) { return std::make_shared<const T>(); });",
          "fire.put(TOPIC, T{});",
          "node.add_impl(xauto::XPU::CPU, [](const xauto::XpuId&) { return xauto::SchedHandle::thread(); },"
          " [topic = TOPIC](State&, const xauto::Input& input) { (void)input.get(topic); });",
          "const xauto::Topic<xauto::Buffered<T>> frames(\"b\");"]


class LargeMessage(unittest.TestCase):
    def compile(self, size):
        lines = ["#include <xauto/buffer.h>", "#include <xauto/testing.h>", "#include <xauto/xauto.h>",
                 "using namespace std::chrono_literals;", "struct State {};", "template <int> struct Message {",
                 f"  unsigned char bytes[{size}];", "};"]
        for number, place in enumerate(PLACES):
            lines += [f"void place{number}(xauto::App& app, xauto::XModule<State>& module, xauto::XNode<State>& node,",
                      "           xauto::testing::Fire& fire) {", f"  using T = Message<{number}>;",
                      "  (void)app, (void)module, (void)node, (void)fire;",
                      "  " + place.replace("TOPIC", "xauto::Topic<T>(\"t\")"), "}"]
        return subprocess.run([os.environ.get("CXX", "c++"), "-std=c++20", "-fsyntax-only", f"-I{common.SOURCE}/include",
                               "-x", "c++", "-"], input="\n".join(lines), capture_output=True, text=True, timeout=250)

    def test_every_place_refuses_it(self):
        fits = self.compile((1 << 20) - 64)  # a Buffered has its Buffer beside
        self.assertEqual(fits.returncode, 0, fits.stderr)
        large = self.compile((1 << 20) + 1)
        self.assertNotEqual(large.returncode, 0)
        said = [line for line in large.stderr.splitlines() if "error:" in line]
        self.assertEqual(len(said), len(PLACES), large.stderr)
        for line in said:
            self.assertIn("xauto::Buffer", line)


if __name__ == "__main__":
    unittest.main()
