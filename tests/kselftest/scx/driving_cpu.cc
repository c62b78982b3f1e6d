// SPDX-License-Identifier: Apache-2.0
// The Driving Case on real CPUs: the graph and the times of examples/driving, each stage burning
// CPU time. For comparing schedulers: --order FILE receives the order in which stages ended.
//   driving_cpu --app-json > app.json
//   xauto run ... -- driving_cpu --order FILE
// The tests' CMake builds it; it is no example, since an XNode should do something useful.
#include <cstdio>
#include <cstring>
#include <ctime>
#include <fstream>
#include <map>
#include <mutex>
#include <set>
#include <string>
#include <vector>

#include <xauto/xauto.h>

#include "../../../examples/driving/times.h"

namespace {

using namespace std::chrono_literals;

struct Frame {
  std::uint64_t number = 0;
};
struct State {
  Frame result;
};
using Node = xauto::XNode<State>;
using Module = xauto::XModule<State>;

int cpu_us(const driving::Stage& stage) {
  return stage.cpu_us > 0 ? stage.cpu_us : stage.gpu_us;
}

void burn(int us) {
  const auto now = [] {
    timespec t{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return t.tv_sec * 1'000'000'000LL + t.tv_nsec;
  };
  for (const long long until = now() + us * 1000LL; now() < until;)
    for (int i = 0; i < 500; ++i) asm volatile("");
}

std::mutex g_mutex;
std::map<std::uint64_t, std::string> g_order;  // activation -> names, guarded by g_mutex

Module make_module(const std::string& name) {
  Module module(name);
  for (const driving::Stage& stage : driving::kStages) {
    if (stage.module != name) continue;
    Node node(stage.xnode);
    node.add_impl(
        xauto::XPU::CPU, [](const xauto::XpuId&) { return xauto::SchedHandle(); },
        [&stage](State& state, const xauto::Input& input) -> xauto::Status {
          burn(cpu_us(stage));
          state.result.number = input.sequence();
          const std::lock_guard lock(g_mutex);
          g_order[input.sequence()] += std::string(" ") + stage.xnode;
          return {};
        });
    module.add_node(node);
  }
  return module;
}

int print_app_json() {
  std::puts(
      "{\"schema\": \"xauto.app\", \"version\": 3, \"name\": \"driving\", \"sources\": "
      "[{\"name\": \"camera/front\"}, {\"name\": \"camera/rear\"}, {\"name\": \"lidar/top\"}], "
      "\"xnodes\": [");
  const std::map<std::string, std::string> heard = {{"LA", "camera/front"},
                                                    {"TD", "camera/front"},
                                                    {"FCD", "camera/front"},
                                                    {"RCD", "camera/rear"},
                                                    {"LD", "lidar/top"}};
  std::vector<std::string> edges;
  std::map<std::string, std::string> first, last;
  bool comma = false;
  for (const driving::Stage& stage : driving::kStages) {
    const auto source = heard.find(stage.module);
    const std::string hears = source == heard.end() || last.contains(stage.module)
                                  ? ""
                                  : "\"source\": \"" + source->second + "\", ";
    std::printf("%s{\"name\": \"%s\", \"module\": \"%s\", %s\"wcet_us\": {\"cpu\": %d}}",
                comma ? ",\n" : "", stage.xnode, stage.module, hears.c_str(),
                cpu_us(stage) * 12 / 10);
    comma = true;
    if (last.contains(stage.module))
      edges.push_back("[\"" + last[stage.module] + "\", \"" + stage.xnode + "\"]");
    else
      first[stage.module] = stage.xnode;
    last[stage.module] = stage.xnode;
  }
  const std::pair<const char*, const char*> topics[] = {
      {"TD", "TC"}, {"FCD", "TR"}, {"RCD", "TR"}, {"LD", "TR"}, {"TR", "PR"}};
  for (const auto& [from, to] : topics)
    edges.push_back("[\"" + last[from] + "\", \"" + first[to] + "\"]");
  std::puts("],\n\"edges\": [");
  for (std::size_t i = 0; i < edges.size(); ++i)
    std::printf("%s%s", i > 0 ? ", " : "", edges[i].c_str());
  std::puts("]}");
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  std::string order;
  for (int i = 1; i < argc; ++i) {
    if (std::strcmp(argv[i], "--app-json") == 0) return print_app_json();
    if (std::strcmp(argv[i], "--order") == 0 && i + 1 < argc) order = argv[++i];
  }
  const xauto::Topic<Frame> front("camera/front"), rear("camera/rear"), lidar("lidar/top");
  const xauto::Topic<Frame> lanes("lanes"), lights("lights"), signals("signals");
  const xauto::Topic<Frame> ahead("obstacles/front"), behind("obstacles/rear"),
      around("obstacles/lidar");
  const xauto::Topic<Frame> tracks("tracks"), paths("paths");
  xauto::App app("driving");
  const auto frame = [](std::uint64_t number) { return Frame{number}; };
  app.add_source(front, 60ms, frame).add_source(rear, 60ms, frame).add_source(lidar, 60ms, frame);
  const auto out = &State::result;
  app.add_module(make_module("LA").add_input_topic(front).add_output_topic(lanes, out));
  app.add_module(make_module("TD").add_input_topic(front).add_output_topic(lights, out));
  app.add_module(make_module("TC").add_input_topic(lights).add_output_topic(signals, out));
  app.add_module(make_module("FCD").add_input_topic(front).add_output_topic(ahead, out));
  app.add_module(make_module("RCD").add_input_topic(rear).add_output_topic(behind, out));
  app.add_module(make_module("LD").add_input_topic(lidar).add_output_topic(around, out));
  app.add_module(make_module("TR")
                     .add_input_topic(ahead)
                     .add_input_topic(behind)
                     .add_input_topic(around)
                     .add_output_topic(tracks, out));
  app.add_module(make_module("PR").add_input_topic(tracks).add_output_topic(paths, out));
  app.on_end([&order] {
    if (order.empty()) return;
    std::ofstream file(order);
    for (const auto& [sequence, names] : g_order) file << sequence << names << "\n";
  });
  return app.main(argc > 0 ? 1 : 0, argv);
}
