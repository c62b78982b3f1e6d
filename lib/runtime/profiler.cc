// SPDX-License-Identifier: Apache-2.0
// An XNode's input is what the XNodes before it left, so the profiler runs the app as a whole: for
// each message of the input, every module in topological order, on one thread. In pass p each XNode
// runs on the p-th of its XPU instances; there are as many passes as the XNode with most instances
// has, and each pass replays the input from its start with fresh module states. Nothing else runs
// on the XPU meanwhile.
#include "runtime/profiler.h"

#include <algorithm>
#include <chrono>
#include <fstream>
#include <map>
#include <memory>
#include <thread>

#include <sys/utsname.h>

#include "base/clock.h"
#include "base/log.h"
#include "base/quantile.h"
#include "base/rt.h"
#include "model/json.h"
#include "record/recording.h"
#include "runtime/input_access.h"

namespace xauto::runtime {
namespace {

constexpr int kFifoProfile = 40;

using Messages = std::vector<std::shared_ptr<const void>>;  ///< [topic]

/// One release after the other, from the recording or from the app's own sources.
class Feed {
 public:
  static Result<Feed> open(const detail::AppSpecErased& app, const Graph& graph,
                           const Session& session) {
    Feed feed(app, graph);
    if (!session.input.empty()) {
      XAUTO_ASSIGN(auto recording, record::Recording::open(session.input));
      feed.recording_.emplace(std::move(recording));
      for (std::size_t t = 0; t < graph.topics.size(); ++t) {
        if (graph.topics[t].source < 0) continue;
        const auto& topics = feed.recording_->topics();
        const auto at = std::find_if(topics.begin(), topics.end(), [&](const auto& topic) {
          return topic.name == graph.topics[t].spec.name;
        });
        if (at == topics.end())
          return fail(ErrorCode::kInvalid,
                      "has no messages for topic '" + graph.topics[t].spec.name + "'",
                      session.input);
      }
    }
    return feed;
  }

  /// False at the end of the recording.
  Result<bool> next(Messages& messages) {
    const std::uint64_t sequence = sequence_++;
    if (!recording_) {
      for (std::size_t t = 0; t < graph_->topics.size(); ++t)
        if (graph_->topics[t].source >= 0)
          messages[t] =
              app_->sources[static_cast<std::size_t>(graph_->topics[t].source)].make(sequence);
      return true;
    }
    std::size_t left = 0;
    for (std::size_t t = 0; t < graph_->topics.size(); ++t) {
      if (graph_->topics[t].source < 0) continue;
      messages[t].reset();
      ++left;
    }
    while (left > 0) {
      XAUTO_ASSIGN(auto message, recording_->next());
      if (!message) return false;
      const std::string& name = recording_->topics()[message->topic].name;
      for (std::size_t t = 0; t < graph_->topics.size(); ++t) {
        const Graph::Topic& topic = graph_->topics[t];
        if (topic.source < 0 || topic.spec.name != name) continue;
        if (topic.spec.decode == nullptr)
          return fail(ErrorCode::kInvalid,
                      "messages of type " + topic.spec.type_name + " cannot be decoded",
                      "topic '" + name + "'", "specialise xauto::Codec for it");
        if (messages[t] == nullptr) --left;
        messages[t] = topic.spec.decode(message->data);
      }
    }
    return true;
  }

 private:
  Feed(const detail::AppSpecErased& app, const Graph& graph) : app_(&app), graph_(&graph) {}
  const detail::AppSpecErased* app_;
  const Graph* graph_;
  std::optional<record::Recording> recording_;
  std::uint64_t sequence_ = 0;
};

Samples summarise(std::vector<std::int64_t> us) {
  if (us.empty()) return {};
  std::sort(us.begin(), us.end());
  return {static_cast<std::int64_t>(us.size()), us.front(), quantile_of_sorted(us, 0.5),
          quantile_of_sorted(us, 0.99), us.back()};
}

ProfileConditions conditions(const Session& session) {
  ProfileConditions c;
  utsname name{};
  uname(&name);
  c.machine = std::string(name.nodename) + " " + name.machine + " " + name.release;
  c.platform = session.platform.name;
  c.emulated = session.emulated;
  c.input = session.input;
  c.warmup = static_cast<std::int64_t>(session.warmup);
  c.repetitions = static_cast<std::int64_t>(session.repetitions);
  std::ifstream("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor") >> c.governor;
  return c;
}

class Run {
 public:
  Run(const detail::AppSpecErased& app, const Session& session, const Graph& graph)
      : app_(app), session_(session), graph_(graph), samples_(graph.nodes.size()) {
    for (const Graph::Node& node : graph.nodes) {
      std::vector<int> xpus;
      for (std::size_t x = 0; x < session.platform.xpus.size(); ++x)
        if (find_impl(*node.spec, session.platform.xpus[x].type) != nullptr)
          xpus.push_back(static_cast<int>(x));
      passes_ = std::max(passes_, xpus.size());
      alternatives_.push_back(std::move(xpus));
    }
  }

  Status run() {
    for (std::size_t n = 0; n < graph_.nodes.size(); ++n)
      if (alternatives_[n].empty())
        return fail(
            ErrorCode::kInfeasible,
            "has no implementation for any XPU of platform '" + session_.platform.name + "'",
            "XNode '" + graph_.nodes[n].name + "'");
    cores_ = rt::allowed_cores();
    rt::set_timer_slack_1ns();
    if (!rt::set_fifo_up_to(kFifoProfile))
      log::warn("no permission for SCHED_FIFO: neighbours' work shows in the times; {}{}",
                session_.fifo_why.empty() ? "" : session_.fifo_why + "; ", rt::fifo_hint());
    const std::uint64_t total = passes_ * (session_.warmup + session_.repetitions);
    std::uint64_t done = 0;
    std::int64_t told = now_ns();
    for (std::size_t pass = 0; pass < passes_; ++pass) {
      XAUTO_ASSIGN(Feed feed, Feed::open(app_, graph_, session_));
      std::vector<std::shared_ptr<void>> states;
      for (const Graph::Module& module : graph_.modules)
        states.push_back(module.spec->make_state());
      for (std::uint64_t k = 0; k < session_.warmup + session_.repetitions; ++k, ++done) {
        Messages messages(graph_.topics.size());
        XAUTO_ASSIGN(const bool more, feed.next(messages));
        if (!more) {
          if (k > session_.warmup)
            break;  // fewer repetitions than asked for; the profile says how many
          return fail(ErrorCode::kInvalid,
                      "ends after " + std::to_string(k) + " releases, within the warm-up",
                      session_.input, "record more, or use fewer --warmup");
        }
        for (const int m : graph_.module_order)
          XAUTO_TRY(run_module(m, pass, k, states[static_cast<std::size_t>(m)].get(), messages));
        if (now_ns() - told > 1'000'000'000) {
          log::info("profile: {} of {} releases", done, total);
          told = now_ns();
        }
      }
    }
    return {};
  }

  Profile result() const {
    Profile p;
    p.app = graph_.name;
    p.conditions = conditions(session_);
    p.margin_pct = session_.margin_pct;
    p.sources = graph_.sources;
    p.edges = graph_.edges;
    for (std::size_t n = 0; n < graph_.nodes.size(); ++n) {
      const Graph::Node& node = graph_.nodes[n];
      XNodeProfile x{
          node.name, graph_.modules[static_cast<std::size_t>(node.module)].name, {}, node.sources};
      for (const auto& [xpu, us] : samples_[n])
        x.on[session_.platform.xpus[static_cast<std::size_t>(xpu)].id] = summarise(us);
      p.xnodes.push_back(std::move(x));
    }
    return p;
  }

 private:
  Status run_module(int m, std::size_t pass, std::uint64_t k, void* state, Messages& messages) {
    const Graph::Module& module = graph_.modules[static_cast<std::size_t>(m)];
    Input input;
    InputAccess::bind(input, &module.spec->inputs);
    InputAccess::stamp(input, now_ns(), k);
    for (std::size_t i = 0; i < module.inputs.size(); ++i) {
      const auto& message = messages[static_cast<std::size_t>(module.inputs[i])];
      InputAccess::messages(input)[i] = {message, now_ns(), k};
    }
    for (const int n : module.nodes) {
      const auto& xpus = alternatives_[static_cast<std::size_t>(n)];
      const int xpu = xpus[pass % xpus.size()];
      XAUTO_ASSIGN(const detail::ImplSpec* impl, prepare(n, xpu));
      const std::string where = "exec of XNode '" + graph_.nodes[static_cast<std::size_t>(n)].name +
                                "' on " + session_.platform.xpus[static_cast<std::size_t>(xpu)].id;
      const std::int64_t before = now_ns();
      try {
        if (Status status = impl->exec(state, input); !status) {
          Error error = std::move(status).error();
          error.where = error.where.empty() ? where : where + ": " + error.where;
          return tl::unexpected<Error>(std::move(error));
        }
      } catch (const std::exception& e) {
        return fail(ErrorCode::kUnavailable, std::string("threw: ") + e.what(), where);
      } catch (...) {
        return fail(ErrorCode::kUnavailable, "threw something that is no std::exception", where);
      }
      const std::int64_t us = (now_ns() - before + 999) / 1000;
      // Each XPU instance once: a later pass that comes round to it again adds nothing new.
      if (k >= session_.warmup && pass < xpus.size())
        samples_[static_cast<std::size_t>(n)][xpu].push_back(us);
    }
    for (std::size_t i = 0; i < module.outputs.size(); ++i)
      messages[static_cast<std::size_t>(module.outputs[i])] = module.spec->outputs[i].take(state);
    return {};
  }

  /// Initialises once per XNode and instance; moves this thread to the core of a real CPU.
  Result<const detail::ImplSpec*> prepare(int n, int xpu) {
    const Xpu& x = session_.platform.xpus[static_cast<std::size_t>(xpu)];
    const Graph::Node& node = graph_.nodes[static_cast<std::size_t>(n)];
    const detail::ImplSpec* impl = find_impl(*node.spec, x.type);
    const XpuId id = xpu_id(session_.platform, xpu);
    if (!session_.emulated) {
      // An XPU's host thread may run anywhere; a CPU XNode runs on the instance that is measured.
      int core = cores_.front();
      if (x.type == "cpu") {
        if (id.index >= static_cast<int>(cores_.size()))
          return fail(ErrorCode::kInvalid,
                      "platform '" + session_.platform.name + "' has more CPUs than the " +
                          std::to_string(cores_.size()) + " that this process may use",
                      x.id, "use a platform file of this machine, or --emulate");
        core = cores_[static_cast<std::size_t>(id.index)];
      }
      if (core != core_now_) {
        XAUTO_TRY(rt::pin_to_core(core));
        core_now_ = core;
      }
    }
    // A closure usually keeps the context that its last init made: coming back needs init again.
    const auto active = active_.find(n);
    if (active == active_.end() || active->second != xpu) {
      const std::string where = "init of XNode '" + node.name + "' on " + x.id;
      try {
        (void)impl->init(id);
      } catch (const std::exception& e) {
        return fail(ErrorCode::kUnavailable, std::string("threw: ") + e.what(), where);
      } catch (...) {
        return fail(ErrorCode::kUnavailable, "threw something that is no std::exception", where);
      }
      active_[n] = xpu;
    }
    return impl;
  }

  const detail::AppSpecErased& app_;
  const Session& session_;
  const Graph& graph_;
  std::vector<std::vector<int>> alternatives_;  ///< [node] -> XPU instances
  std::size_t passes_ = 0;
  std::vector<std::map<int, std::vector<std::int64_t>>> samples_;  ///< [node] XPU -> us
  std::map<int, int> active_;  ///< node -> XPU it was last initialised for
  std::vector<int> cores_;
  int core_now_ = -1;
};

}  // namespace

Result<std::string> profile(const detail::AppSpecErased& app, const Session& session) {
  XAUTO_ASSIGN(const Graph graph, Graph::build(app));
  Run run(app, session, graph);
  // A thread of its own, so that the caller's priority and affinity stay as they are.
  Status status;
  std::thread([&] { status = run.run(); }).join();
  XAUTO_TRY(status);
  return to_json(run.result());
}

Result<std::string> describe(const Graph& graph, const Platform& platform) {
  Profile p;
  p.app = graph.name;
  p.conditions.platform = platform.name;
  p.sources = graph.sources;
  p.edges = graph.edges;
  for (const Graph::Node& node : graph.nodes)
    p.xnodes.push_back(
        {node.name, graph.modules[static_cast<std::size_t>(node.module)].name, {}, node.sources});
  return to_json(p);
}

}  // namespace xauto::runtime
