// SPDX-License-Identifier: Apache-2.0
// An app in this process with real coordinators in threads, for the tests of the engine.
#pragma once

#include <algorithm>
#include <atomic>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include <sys/eventfd.h>
#include <unistd.h>

#include <xauto/xauto.h>

#include "base/socket.h"
#include "coord/server.h"
#include "engine/engine.h"
#include "graph/app_spec.h"
#include "xpu/kind.h"

namespace xauto::runtime {

using namespace std::chrono_literals;

struct TestState {
  int sum = 0;
};

/// camera -> A (a1 on cpu, a2 on npu) ┬-> C (c1 on npu, reads both)
///         -> B (b1 on npu)           ┘
class TestApp {
 public:
  TestApp() : TestApp(Bare{}) {
    const Topic<int> a("a"), b("b"), c("c");
    add("A", {"a1", "a2"}, {*detail::topic_spec(camera)}, a);
    add("B", {"b1"}, {*detail::topic_spec(camera)}, b);
    add("C", {"c1"}, {*detail::topic_spec(a), *detail::topic_spec(b)}, c);

    for (const char* name : {"a1", "a2", "b1", "c1"})
      session.app.xnodes.push_back({name,
                                    std::string(1, static_cast<char>(std::toupper(name[0]))),
                                    {{name == std::string("a1") ? "cpu" : "npu", 10}}});
    session.app.edges = {{0, 1}, {1, 3}, {2, 3}};
    session.policy.placements = {{0, 4}, {1, 3}, {1, 2}, {1, 1}};
  }
  /// The camera, and no module.
  struct Bare {};
  explicit TestApp(Bare) {
    spec.name = "test";
    detail::SourceSpec source{
        *detail::topic_spec(camera),
        {1000},
        [](std::uint64_t k, detail::MessageMemory*) -> std::shared_ptr<const void> {
          return std::make_shared<const int>(static_cast<int>(k));
        }};
    spec.sources.push_back(source);
    session.platform.name = "test";
    session.platform.xpus = {{"cpu0", "cpu"}, {"npu0", "npu", false}};
    session.app.name = "test";
    session.cpu.sched = CpuSched::kOther;
    session.releases.activations = 50;
    session.releases.lockstep = true;
  }

  /// Called in every exec, with the XNode's name and the activation's number.
  std::function<Status(const std::string&, std::uint64_t)> exec = [](auto&&...) {
    return Status();
  };

  /// What init returns on the NPU.
  std::function<SchedHandle()> handle = [] { return SchedHandle::gate(); };
  /// ... and what it owns, anywhere.
  std::function<std::shared_ptr<void>(const std::string& node)> object = [](auto&&) {
    return nullptr;
  };
  std::atomic<bool>* stop_when = nullptr;  ///< then the run is told to stop
  std::atomic<int> foreign_objects{0};     ///< execs that were given another object than their own

  std::vector<std::string> log() {
    const std::lock_guard lock(mutex_);
    return log_;
  }

  Result<RunReport> run() {
    std::vector<std::unique_ptr<coord::Server>> servers;
    std::vector<std::thread> threads;
    const UniqueFd stop(eventfd(0, EFD_CLOEXEC));
    static std::atomic<int> runs{0};
    if (session.scheduling == Scheduling::kXAuto) {
      for (const Xpu& xpu : session.platform.xpus) {
        const std::string address = "xauto-test/engine-" + std::to_string(getpid()) + "-" +
                                    std::to_string(runs.fetch_add(1)) + "/" + xpu.id;
        coord::ServerOptions options{address, xpu.id, xpu::discipline_of(xpu, false), {}, {}};
        options.levels = xpu::levels_of(xpu, false);
        for (const auto& xnode : session.app.xnodes) options.xnodes.push_back(xnode.name);
        for (const auto& [u, v] : session.policy.order)
          if (session.policy.placements[static_cast<std::size_t>(u)].xpu ==
              session.platform.find(xpu.id))
            options.order.emplace_back(u, v);
        servers.push_back(std::move(*coord::Server::create(std::move(options))));
        threads.emplace_back(
            [server = servers.back().get(), &stop] { (void)server->run(stop.get()); });
        session.coordinators[xpu.id] = address;
      }
    }
    Result<RunReport> report = fail(ErrorCode::kInternal, "not run");
    std::atomic<bool> never{false};
    auto engine = Engine::create(spec, session, stop_when != nullptr ? *stop_when : never);
    if (engine)
      report = (*engine)->run();
    else
      report = tl::unexpected<Error>(engine.error());
    if (engine) engine->reset();
    signal_eventfd(stop.get());
    for (std::thread& thread : threads) thread.join();
    return report;
  }

  const Topic<int> camera{"camera"};
  detail::AppSpecErased spec;
  Session session;

  /// A module whose XNodes can run on both XPUs.
  void add(const std::string& name, const std::vector<std::string>& nodes,
           std::vector<detail::TopicSpec> inputs, const Topic<int>& output) {
    auto module = std::make_shared<detail::XModuleSpec>();
    module->name = name;
    module->make_state = []() -> std::shared_ptr<void> { return std::make_shared<TestState>(); };
    for (const std::string& node : nodes) {
      auto made = std::make_shared<detail::XNodeSpecErased>();
      made->name = node;
      for (const char* type : {"cpu", "npu"})
        made->impls.push_back({XPU(type),
                               [this, node](const XpuId& xpu, void*, std::shared_ptr<void>& owned) {
                                 owned = object(node);
                                 const std::lock_guard lock(mutex_);
                                 objects_[node] = owned.get();
                                 return xpu.type == XPU("npu") ? handle() : SchedHandle::gate();
                               },
                               [this, node](void* own, void*, const Input& input) -> Status {
                                 {
                                   const std::lock_guard lock(mutex_);
                                   log_.push_back(node + "#" + std::to_string(input.sequence()));
                                   if (objects_[node] != own) ++foreign_objects;
                                 }
                                 return exec(node, input.sequence());
                               }});
      module->nodes.push_back(made);
    }
    module->inputs = std::move(inputs);
    module->outputs = {{*detail::topic_spec(output), [](void*, detail::MessageMemory*) {
                          return std::make_shared<const int>(1);
                        }}};
    spec.modules.push_back(module);
  }

 private:
  std::mutex mutex_;
  std::vector<std::string> log_;
  std::map<std::string, void*> objects_;  ///< [XNode]
};

inline std::uint64_t count(const std::vector<std::string>& log, const std::string& node) {
  return static_cast<std::uint64_t>(std::count_if(
      log.begin(), log.end(), [&](const std::string& l) { return l.rfind(node + "#", 0) == 0; }));
}

}  // namespace xauto::runtime
