// SPDX-License-Identifier: Apache-2.0
// What it costs to get from one XNode to the next: chains and a DAG of empty nodes. From the
// trigger to "the last node has run" as the triggering thread sees it, by the number of nodes.
//
//   call         functions called in order: what is left when there is no runtime at all
//   own-worker   one thread, ready ring, join counters, one futex hand-over each way: the floor
//   xauto        the engine, as `xauto run` uses it, coordinator included
//   tbb-flow     oneTBB's flow graph (where it is installed)
//   others       peers.h, where their packages are installed
#include <atomic>
#include <memory>
#include <thread>

#include <sys/eventfd.h>
#include <unistd.h>

#include "base/futex.h"
#include "base/socket.h"
#include "coord/server.h"
#include "engine/engine.h"
#include "launch/supervisor.h"

#include "bench.h"
#include "peers.h"

#ifdef XAUTO_BENCH_TBB
#include <tbb/flow_graph.h>
#endif

namespace xauto::bench {
namespace {

Samples run_calls(const Dag& dag, std::uint64_t rounds) {
  Samples samples;
  samples.reserve(rounds);
  for (std::uint64_t k = 0; k < rounds; ++k) {
    const std::int64_t start = now_ns();
    for (int i = 0; i < dag.nodes; ++i) node_body();
    samples.add(now_ns() - start);
  }
  return samples;
}

Samples run_own_worker(const Dag& dag, std::uint64_t rounds) {
  std::atomic<std::uint32_t> go{0}, done{0};
  std::atomic<bool> quit{false};
  std::thread worker([&] {
    rt::set_timer_slack_1ns();
    std::vector<int> left(dag.before), ring(static_cast<std::size_t>(dag.nodes));
    for (std::uint32_t seen = 0;;) {
      while (go.load() == seen && !quit.load()) futex_wait_local(go, seen);
      if (quit.load()) return;
      seen = go.load();
      left = dag.before;
      std::size_t head = 0, tail = 0;
      for (int i = 0; i < dag.nodes; ++i)
        if (left[static_cast<std::size_t>(i)] == 0) ring[tail++] = i;
      while (head < tail) {
        const auto i = static_cast<std::size_t>(ring[head++]);
        node_body();
        for (const int next : dag.after[i])
          if (--left[static_cast<std::size_t>(next)] == 0) ring[tail++] = next;
      }
      done.store(seen);
      futex_wake_local(done, 1);
    }
  });
  Samples samples;
  samples.reserve(rounds);
  for (std::uint32_t k = 1; k <= rounds; ++k) {
    const std::int64_t start = now_ns();
    go.store(k);
    futex_wake_local(go, 1);
    for (std::uint32_t seen; (seen = done.load()) != k;) futex_wait_local(done, seen);
    samples.add(now_ns() - start);
  }
  quit.store(true);
  go.fetch_add(1);
  futex_wake_local(go, 1);
  worker.join();
  return samples;
}

/// A thread per node, each woken by the one before it: what a change of XPU costs at least.
Samples run_thread_per_node(int nodes, std::uint64_t rounds) {
  std::vector<std::atomic<std::uint32_t>> word(static_cast<std::size_t>(nodes) + 1);
  std::atomic<bool> quit{false};
  std::vector<std::thread> threads;
  for (int i = 0; i < nodes; ++i)
    threads.emplace_back([&, i] {
      auto& mine = word[static_cast<std::size_t>(i)];
      auto& next = word[static_cast<std::size_t>(i) + 1];
      for (std::uint32_t seen = 0;;) {
        while (mine.load() == seen) futex_wait_local(mine, seen);
        seen = mine.load();
        if (quit.load()) return;
        node_body();
        next.store(seen);
        futex_wake_local(next, 1);
      }
    });
  Samples samples;
  samples.reserve(rounds);
  auto& last = word[static_cast<std::size_t>(nodes)];
  for (std::uint32_t k = 1; k <= rounds; ++k) {
    const std::int64_t start = now_ns();
    word[0].store(k);
    futex_wake_local(word[0], 1);
    for (std::uint32_t seen; (seen = last.load()) != k;) futex_wait_local(last, seen);
    samples.add(now_ns() - start);
  }
  quit.store(true);
  for (auto& w : word) {
    w.fetch_add(1);
    futex_wake_local(w, 1);
  }
  for (std::thread& thread : threads) thread.join();
  return samples;
}

/// The engine in lockstep. One trigger after the other: the time between two is release, dispatch
/// of all nodes, and the wake-up of the releasing thread.
///
/// `as_chain`: one XModule with all nodes; otherwise a module per node, an edge is a topic.
Samples run_xauto(const Dag& dag, bool as_chain, int xpus, std::uint64_t rounds) {
  static std::atomic<int> runs{0};
  detail::AppSpecErased app;
  runtime::Session session;
  Samples samples;
  samples.reserve(rounds);
  std::int64_t last = 0;
  const Topic<int> source("source");
  app.name = session.app.name = "bench";
  app.sources.push_back(
      {*detail::topic_spec(source), Period{1000},
       [&](std::uint64_t k, detail::MessageMemory*) -> std::shared_ptr<const void> {
         const std::int64_t now = now_ns();
         if (k > rounds / 10) samples.add(now - last);  // warm by then
         last = now;
         return std::make_shared<const int>(0);
       }});
  session.platform.name = "bench";
  for (int x = 0; x < xpus; ++x)
    session.platform.xpus.push_back({"npu" + std::to_string(x), "npu", false});
  const auto node = [&](int i, const std::string& module) {
    auto made = std::make_shared<detail::XNodeSpecErased>();
    made->name = "n" + std::to_string(i);
    made->impls.push_back({XPU("npu"), [](auto&&...) { return SchedHandle::gate(); },
                           [](void*, void*, const Input&) -> Status {
                             node_body();
                             return {};
                           }});
    session.app.xnodes.push_back({made->name, module, {{"npu", 1}}});
    session.policy.placements.push_back({i % xpus, 1000 - i});
    return made;
  };
  const auto module = [&](const std::string& name) {
    auto made = std::make_shared<detail::XModuleSpec>();
    made->name = name;
    made->make_state = []() -> std::shared_ptr<void> { return std::make_shared<int>(0); };
    app.modules.push_back(made);
    return made;
  };
  if (as_chain) {
    auto made = module("chain");
    made->inputs = {*detail::topic_spec(source)};
    for (int i = 0; i < dag.nodes; ++i) {
      made->nodes.push_back(node(i, "chain"));
      if (i > 0) session.app.edges.emplace_back(i - 1, i);
    }
  } else {
    std::vector<Topic<int>> topics;
    for (int i = 0; i < dag.nodes; ++i) topics.emplace_back("t" + std::to_string(i));
    for (int i = 0; i < dag.nodes; ++i) {
      auto made = module("m" + std::to_string(i));
      made->nodes.push_back(node(i, made->name));
      static const auto value = std::make_shared<const int>(1);
      if (!dag.after[static_cast<std::size_t>(i)].empty())
        made->outputs.push_back(
            {*detail::topic_spec(topics[static_cast<std::size_t>(i)]),
             [](void*, detail::MessageMemory*) -> std::shared_ptr<const void> { return value; }});
      if (dag.before[static_cast<std::size_t>(i)] == 0)
        made->inputs.push_back(*detail::topic_spec(source));
    }
    for (int u = 0; u < dag.nodes; ++u)
      for (const int v : dag.after[static_cast<std::size_t>(u)]) {
        app.modules[static_cast<std::size_t>(v)]->inputs.push_back(
            *detail::topic_spec(topics[static_cast<std::size_t>(u)]));
        session.app.edges.emplace_back(u, v);
      }
  }
  session.cpu.sched = runtime::CpuSched::kOther;
  session.releases.activations = rounds + rounds / 10;
  session.releases.lockstep = true;

  const UniqueFd stop(eventfd(0, EFD_CLOEXEC));
  std::vector<std::unique_ptr<coord::Server>> servers;
  std::vector<std::thread> threads;
  for (const Xpu& xpu : session.platform.xpus) {
    const std::string address = "xauto-bench/" + std::to_string(getpid()) + "-" +
                                std::to_string(runs.fetch_add(1)) + "/" + xpu.id;
    coord::ServerOptions options;
    options.address = address;
    options.xpu = xpu.id;
    options.discipline = xpu::discipline_of(xpu, false);
    options.xnodes.assign(session.app.xnodes.size(), "n");
    servers.push_back(std::move(*coord::Server::create(std::move(options))));
    threads.emplace_back([server = servers.back().get(), &stop] {
      rt::set_timer_slack_1ns();
      (void)server->run(stop.get());
    });
    session.coordinators[xpu.id] = address;
  }
  {
    std::atomic<bool> never{false};
    auto engine = runtime::Engine::create(app, session, never);
    if (!engine) {
      fmt::print(stderr, "xauto: {}\n", engine.error().to_string());
    } else {
      const auto report = (*engine)->run();
      if (!report || !report->complete) fmt::print(stderr, "xauto: the run is not complete\n");
    }
  }
  signal_eventfd(stop.get());
  for (std::thread& thread : threads) thread.join();
  return samples;
}

#ifdef XAUTO_BENCH_TBB
Samples run_tbb(const Dag& dag, std::uint64_t rounds) {
  using Node = tbb::flow::continue_node<tbb::flow::continue_msg>;
  tbb::flow::graph graph;
  std::vector<std::unique_ptr<Node>> nodes;
  for (int i = 0; i < dag.nodes; ++i)
    nodes.push_back(
        std::make_unique<Node>(graph, [](const tbb::flow::continue_msg&) { node_body(); }));
  for (int u = 0; u < dag.nodes; ++u)
    for (const int v : dag.after[static_cast<std::size_t>(u)])
      tbb::flow::make_edge(*nodes[static_cast<std::size_t>(u)],
                           *nodes[static_cast<std::size_t>(v)]);
  Samples samples;
  samples.reserve(rounds);
  for (std::uint64_t k = 0; k < rounds; ++k) {
    const std::int64_t start = now_ns();
    nodes[0]->try_put(tbb::flow::continue_msg());
    graph.wait_for_all();
    samples.add(now_ns() - start);
  }
  return samples;
}
#endif

}  // namespace

void dispatch(const Options& options, Table& table) {
  // Everybody on one core: what is measured is the work, not the inter-processor interrupts.
  if (const Status pinned = rt::pin_to_core(cores().first); !pinned) return;
  if (options.fifo) (void)rt::set_fifo(45);  // inherited by the threads of all rows
  for (const Dag& dag : {chain(1), chain(3), chain(10), dag40()}) {
    const bool is_chain = dag.nodes != 40;
    const double n = dag.nodes;
    auto calls = run_calls(dag, options.rounds);
    table.add("dispatch", dag.name, "call", calls, n);
    auto own = run_own_worker(dag, options.rounds);
    table.add("dispatch", dag.name, "own-worker", own, n);
    auto ours = run_xauto(dag, is_chain, 1, options.rounds);
    table.add("dispatch", dag.name, "xauto", ours, n);
#ifdef XAUTO_BENCH_TBB
    auto tbb = run_tbb(dag, options.rounds);
    table.add("dispatch", dag.name, "tbb-flow", tbb, n);
#endif
    for (const Peer& peer : peers())
      if (peer.dispatch != nullptr)
        add_peer(
            table, "dispatch", dag.name, peer.dispatch_name,
            [&] { return peer.dispatch(options, dag); }, n);
  }
  auto floor = run_thread_per_node(10, options.rounds);
  table.add("dispatch", "xpu change", "futex hand-over", floor, 10);
  auto hops = run_xauto(chain(10), true, 2, options.rounds);
  table.add("dispatch", "xpu change", "xauto", hops, 10);
}

}  // namespace xauto::bench
