// SPDX-License-Identifier: Apache-2.0
// StarPU: tasks with explicit dependencies, submitted anew for each activation, which is how it is
// used. Its idle worker polls, so it has the second core to itself and no SCHED_FIFO.
#include <memory>

#include <starpu.h>

#include "peers.h"

namespace xauto::bench {
namespace {

void run_node(void*[], void*) {
  node_body();
}

}  // namespace

Samples starpu_dispatch(const Options& options, const Dag& dag) {
  Samples samples;
  setenv("STARPU_SILENT", "1", 0);
  setenv("STARPU_CALIBRATE", "0", 1);
  setenv("STARPU_HOME", "/nonexistent", 1);  // it would write what it measured into the home folder
  starpu_conf conf;
  starpu_conf_init(&conf);
  conf.ncpus = 1;
  conf.ncuda = 0;
  conf.nopencl = 0;
  conf.sched_policy_name = "eager";
  conf.use_explicit_workers_bindid = 1;
  conf.workers_bindid[0] = static_cast<unsigned>(cores().second);
  if (starpu_init(&conf) != 0) return samples;
  (void)rt::pin_to_core(cores().first);
  starpu_codelet codelet;
  starpu_codelet_init(&codelet);
  codelet.cpu_funcs[0] = run_node;
  codelet.nbuffers = 0;
  const auto n = static_cast<std::size_t>(dag.nodes);
  std::vector<std::vector<std::size_t>> before(n);
  for (std::size_t u = 0; u < n; ++u)
    for (const int v : dag.after[u]) before[static_cast<std::size_t>(v)].push_back(u);
  std::vector<starpu_task*> tasks(n), deps;
  samples.reserve(options.rounds);
  for (std::uint64_t k = 0; k < options.rounds; ++k) {
    const std::int64_t start = now_ns();
    for (std::size_t i = 0; i < n; ++i) {
      tasks[i] = starpu_task_create();
      tasks[i]->cl = &codelet;
      tasks[i]->destroy = 0;  // a predecessor may be over before its successor is submitted
      deps.clear();
      for (const std::size_t u : before[i]) deps.push_back(tasks[u]);
      if (!deps.empty())
        starpu_task_declare_deps_array(tasks[i], static_cast<unsigned>(deps.size()), deps.data());
    }
    for (starpu_task* task : tasks)
      if (starpu_task_submit(task) != 0) std::abort();
    starpu_task_wait_for_all();
    samples.add(now_ns() - start);
    for (starpu_task* task : tasks) starpu_task_destroy(task);
  }
  starpu_shutdown();
  return samples;
}

}  // namespace xauto::bench
