// SPDX-License-Identifier: Apache-2.0
// An app whose modules have parameters.
//
//   tick ─► A ─► a ─► B ─► b        A: a.first, a.second, on one core each
//
//   params FILE [period US | crash N]
//
// FILE gets a line per message of a and b as it comes: topic, number, and what both XNodes read of
// the module's parameters, "first|second". crash: B's process ends itself in its Nth activation.
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <string>

#include <xauto/xauto.h>

using namespace std::chrono_literals;

namespace {

struct Line {
  char text[1100] = {};
};
struct State {
  std::string first, second;
  Line line;
};

const xauto::Parameter<bool> on("on", true);
const xauto::Parameter<int> count("count", 3, 0, 100);
const xauto::Parameter<double> gain("gain", 0.5, -1, 1);
const xauto::Parameter<std::string> mode("mode", "day");
const xauto::Parameter<std::string> twin("twin", "day");  // set together with `mode`

std::string read(const xauto::Input& input) {
  return std::to_string(input.value(on)) + "," + std::to_string(input.value(count)) + "," +
         std::to_string(input.value(gain)) + "," + input.value(mode) + "," + input.value(twin);
}

xauto::SchedHandle thread(const xauto::XpuId&) {
  return xauto::SchedHandle::thread();
}

}  // namespace

int main(int argc, char** argv) {
  const std::string file = argc > 1 ? argv[1] : "/dev/null";
  const std::string what = argc > 3 ? argv[2] : "";
  const std::uint64_t number = argc > 3 ? std::strtoull(argv[3], nullptr, 10) : 0;
  const auto period = std::chrono::microseconds(what == "period" ? number : 5000);

  const xauto::Topic<std::uint64_t> tick("tick");
  const xauto::Topic<Line> a("a"), b("b");
  xauto::XNode<State> a1("a.first"), a2("a.second"), b1("b.only");
  a1.add_impl(xauto::XPU::CPU, thread,
              [](State& state, const xauto::Input& input) { state.first = read(input); });
  a2.add_impl(xauto::XPU::CPU, thread,
              [](State& state, const xauto::Input& input) { state.second = read(input); });
  a1.add_parameter(mode).add_parameter(twin);
  b1.add_impl(xauto::XPU::CPU, thread, [&](State& state, const xauto::Input& input) {
    if (what == "crash" && input.sequence() == number) std::abort();
    state.first = state.second = input.value(mode);
  });
  const auto line = [](State& state) {
    std::strncpy(state.line.text, (state.first + "|" + state.second).c_str(),
                 sizeof state.line.text - 1);
    return state.line;
  };
  xauto::XModule<State> first("A"), second("B");
  first.add_node(a1).add_node(a2).add_input_topic(tick).add_output_topic(a, line);
  first.add_parameter(on).add_parameter(count).add_parameter(gain).add_parameter(mode);
  second.add_node(b1).add_input_topic(a).add_output_topic(b, line).add_parameter(mode);

  std::ofstream out(file);
  const auto print = [&out](const char* topic) {
    return [&out, topic](const Line& message, std::uint64_t sequence) {
      out << topic << " " << sequence << " " << message.text << std::endl;
    };
  };
  xauto::App app("params");
  app.add_source(tick, period, [](std::uint64_t k) { return k; });
  app.add_module(first).add_module(second);
  app.on_message(a, print("a")).on_message(b, print("b"));
  return app.main(argc, argv);
}
