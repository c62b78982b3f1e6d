// SPDX-License-Identifier: Apache-2.0
#include "launch/cpu_run.h"

#include <algorithm>
#include <set>

#include "base/core_levels.h"
#include "base/log.h"
#include "base/rt.h"
#include "coord/rule.h"
#include "session/policy_rows.h"

namespace xauto::launch {
namespace {

std::size_t num_tasks(const CpuRunRequest& request) {
  return request.app.xnodes.size() * std::max<std::size_t>(1, request.tables.size());
}

}  // namespace

std::vector<kernel::TableRow> table_rows(const CpuRunRequest& request,
                                         const std::vector<int>& cores) {
  std::vector<kernel::TableRow> rows(num_tasks(request));
  if (request.tables.empty()) return rows;
  const std::vector<int> cpus = request.platform.instances_of("cpu");
  const std::size_t xnodes = request.app.xnodes.size();
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const PriorityPlacement& placement = request.tables[i / xnodes]->placements[i % xnodes];
    const auto cpu = std::find(cpus.begin(), cpus.end(), placement.xpu);
    if (cpu == cpus.end() || !request.real[static_cast<std::size_t>(*cpu)]) continue;
    const auto instance = static_cast<std::size_t>(cpu - cpus.begin());
    if (instance >= cores.size()) continue;
    rows[i].cpu = static_cast<std::uint32_t>(cores[instance]);
    rows[i].key = request.keys ? 0 : coord::key_of_priority(placement.priority);
    if (const auto wcet = request.app.xnodes[i % xnodes].wcet_on("cpu"))
      rows[i].budget_us = *wcet * request.budget_pct / 100;
  }
  return rows;
}

namespace {

std::vector<kernel::XNodeName> names_of(const CpuRunRequest& request) {
  std::vector<kernel::XNodeName> names;
  const std::size_t xnodes = request.app.xnodes.size();
  for (std::size_t i = 0; i < num_tasks(request); ++i) {
    const int xpu =
        request.tables.empty() ? -1 : request.tables[i / xnodes]->placements[i % xnodes].xpu;
    const auto at = static_cast<std::size_t>(std::max(xpu, 0));
    names.push_back({request.app.xnodes[i % xnodes].name,
                     xpu < 0 ? std::string() : request.platform.xpus[at].id,
                     static_cast<std::uint32_t>(at)});
  }
  return names;
}

/// Under the scheduler that another run of XAuto has loaded, if there is one: by its rule, with rows
/// of our own in its table. SCHED_FIFO would go before all of its XNodes.
bool join_other(const CpuRunRequest& request, const std::vector<kernel::TableRow>& rows,
                CpuRun& run) {
  for (const std::string& other : kernel::RunMaps::runs()) {
    auto seen = kernel::RunMaps::open(other);
    if (other == request.run || !seen || seen->sched().running == 0) continue;
    auto maps = kernel::RunMaps::join(other, static_cast<std::uint32_t>(rows.size()));
    if (!maps || !maps->replace_table(rows) || !maps->set_names(names_of(request))) continue;
    auto scheduler = kernel::start_scx(request.bin, other, {}, {"--join"});
    if (!scheduler) continue;
    run.maps.emplace(std::move(*maps));
    run.info = "sched_ext, " + scheduler->why;
    run.note = "CPUs are shared with run '" + other +
               "'; worst cases are those of an app that has them alone";
    run.partial = scheduler->why.rfind("partial", 0) == 0;
    run.scheduler.emplace(std::move(*scheduler));
    return true;
  }
  return false;
}

}  // namespace

Result<DeployedPolicy> deploy_policy(const runtime::Session& session, const std::string& run,
                                     const kernel::RunMaps* maps) {
  XAUTO_ASSIGN(xpu::PolicyView map, xpu::PolicyView::create(runtime::policy_rows(
                                        session, runtime::first_table(session))));
  std::optional<kernel::RunFolder> folder;
  if (maps == nullptr || maps->run() != run) {
    XAUTO_ASSIGN(folder, kernel::RunFolder::make(run));
  }
  XAUTO_TRY(map.pin(kernel::RunFolder::path_of(run)));
  return DeployedPolicy{std::move(folder), std::move(map)};
}

CpuRun prepare_cpus(const CpuRunRequest& request) {
  CpuRun run;
  const std::vector<int> all = request.platform.instances_of("cpu");
  const bool real_cpus = std::any_of(
      all.begin(), all.end(), [&](int x) { return request.real[static_cast<std::size_t>(x)]; });
  const bool want_ext = request.want_ext && !request.tables.empty() && real_cpus;
  if (request.want_ext && !real_cpus)
    run.note = "the CPUs are emulated: --cpu-sched ext has no effect";
  const auto instead = [&](const Error& error) {
    // Ours, and it was not joined.
    const bool unseen = error.what.find("is loaded: 'xauto") != std::string::npos &&
                        kernel::RunMaps::runs() == std::vector{request.run};
    run.note =
        "no sched_ext: " + error.what +
        (unseen ? ", of a run that is not seen here: a container has to share /sys/fs/bpf" : "") +
        "; SCHED_FIFO instead";
    run.scheduler.reset();
  };
  const std::vector<kernel::TableRow> rows = table_rows(request, rt::allowed_cores());
  if (want_ext && join_other(request, rows, run)) return run;
  // The program alone knows how many threads it has: one for each activation in flight. A slot is
  // 200 bytes.
  auto maps = kernel::RunMaps::create(request.run, static_cast<std::uint32_t>(num_tasks(request)),
                                      XAUTO_BPF_MAX_SLOTS);
  if (!maps) {
    if (want_ext) instead(maps.error());
    log::debug("this run cannot be observed: {}", maps.error().to_string());
    return run;
  }
  run.maps.emplace(std::move(*maps));
  if (const Status put = run.maps->replace_table(rows); !put) {
    if (want_ext) instead(put.error());
    return run;
  }
  (void)run.maps->set_names(names_of(request));
  if (!want_ext) return run;
  std::set<int> cpus;
  for (const kernel::TableRow& row : rows)
    if (row.cpu != XAUTO_BPF_NO_CPU) cpus.insert(static_cast<int>(row.cpu));
  auto scheduler =
      kernel::start_scx(request.bin, request.run, std::vector<int>(cpus.begin(), cpus.end()));
  if (!scheduler) {
    instead(scheduler.error());
    return run;
  }
  run.info = "sched_ext, " + scheduler->why;
  run.partial = scheduler->why.rfind("partial", 0) == 0;
  run.scheduler.emplace(std::move(*scheduler));
  return run;
}

void decide_cpu_by_keys(runtime::Session& session) {
  constexpr int kLevels = kCpuAsks + 3;  // and those above: model/fifo_range.h
  session.cpu.by_keys = session.keys && session.scheduling == runtime::Scheduling::kXAuto &&
                        session.cpu.sched == runtime::CpuSched::kFifo &&
                        (session.cpu.regulated || rt::highest_fifo() >= kLevels);
}

std::string cpu_keeper(const runtime::Session& session) {
  const std::vector<int> cpus = session.platform.instances_of("cpu");
  const bool real = std::any_of(cpus.begin(), cpus.end(),
                                [&](int x) { return session.presence_of(x) == Presence::kReal; });
  if (!real || session.scheduling != runtime::Scheduling::kXAuto) return {};
  if (session.cpu.sched == runtime::CpuSched::kExt) return "sched_ext";
  if (session.cpu.by_keys) return "SCHED_FIFO, told by coordinators";
  const bool fifo = session.cpu.sched == runtime::CpuSched::kFifo && rt::highest_fifo() > 0;
  return fifo && !session.keys ? "SCHED_FIFO" : "nobody";
}

}  // namespace xauto::launch
