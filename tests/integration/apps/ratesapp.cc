// SPDX-License-Identifier: Apache-2.0
// An app of independent sensors, each with a chain of its own, on emulated XPUs:
//
//   ratesapp FILE NAME:PERIOD_US:STAGE,...  ...      STAGE = IMPL[/IMPL...]
//                                                    IMPL = TYPE=US[+HOST_US]
//
// Sensor NAME releases every PERIOD_US to XModule NAME, whose XNodes NAME.0, NAME.1, ... take US on
// an XPU of that type, and then HOST_US without it. FILE gets a line per sensor at the end, by
// observers with a clock of their own: NAME MESSAGES LONGEST_US LATEST_NUMBER.
#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <sstream>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include <xauto/emu.h>
#include <xauto/xauto.h>

namespace {

using std::chrono::microseconds;

struct Result {
  std::int64_t origin_ns = 0;
};
struct Seen {
  std::uint64_t messages = 0, latest = 0;
  std::int64_t longest_us = 0;
};

std::vector<std::string> split(const std::string& text, char at) {
  std::vector<std::string> parts;
  std::istringstream in(text);
  for (std::string part; std::getline(in, part, at);) parts.push_back(part);
  return parts;
}

xauto::XNode<Result> stage(const std::string& name, const std::string& text) {
  xauto::XNode<Result> node(name);
  for (const std::string& impl : split(text, '/')) {
    const auto parts = split(impl, '=');
    if (parts.size() != 2) throw std::runtime_error("no TYPE=US: " + impl);
    const auto times = split(parts[1], '+');
    const microseconds work(std::atoll(times[0].c_str()));
    const microseconds host(times.size() > 1 ? std::atoll(times[1].c_str()) : 0);
    auto context = std::make_shared<std::optional<xauto::emu::Context>>();
    node.add_impl(
        xauto::XPU(parts[0]),
        [context](const xauto::XpuId& xpu) {
          auto opened = xauto::emu::Context::open(xpu);
          if (!opened) throw std::runtime_error(opened.error().to_string());
          *context = std::move(*opened);
          return (*context)->handle();
        },
        [context, work, host](Result& state, const xauto::Input& input) {
          state.origin_ns = input.origin().count();
          xauto::Status done = (*context)->run(work);
          std::this_thread::sleep_for(host);
          return done;
        });
  }
  return node;
}

}  // namespace

int main(int argc, char** argv) {
  const std::string file = argc > 1 ? argv[1] : "/dev/null";
  xauto::App app("ratesapp");
  std::mutex mutex;
  std::map<std::string, Seen> seen;
  for (int i = 2; i < argc; ++i) {
    const auto parts = split(argv[i], ':');
    if (parts.size() != 3)
      throw std::runtime_error(std::string("no NAME:PERIOD_US:STAGES: ") + argv[i]);
    const std::string name = parts[0];
    const xauto::Topic<std::uint64_t> in("in/" + name);
    const xauto::Topic<Result> out("out/" + name);
    app.add_source(in, microseconds(std::atoll(parts[1].c_str())),
                   [](std::uint64_t k) { return k; });
    xauto::XModule<Result> module(name);
    int number = 0;
    for (const std::string& text : split(parts[2], ','))
      module.add_node(stage(name + "." + std::to_string(number++), text));
    module.add_input_topic(in);
    module.add_output_topic(out, [](Result& state) { return state; });
    app.add_module(module);
    seen[name];
    app.on_message(out, [&, name](const Result& result, std::uint64_t k) {
      const auto now = std::chrono::steady_clock::now().time_since_epoch();
      const std::lock_guard lock(mutex);
      Seen& s = seen[name];
      ++s.messages;
      s.latest = k;
      s.longest_us = std::max<std::int64_t>(
          s.longest_us,
          (std::chrono::duration_cast<std::chrono::nanoseconds>(now).count() - result.origin_ns) /
              1000);
    });
  }
  app.on_end([&] {
    std::ofstream out(file);
    for (const auto& [name, s] : seen)
      out << name << " " << s.messages << " " << s.longest_us << " " << s.latest << "\n";
  });
  return app.main(argc, argv);
}
