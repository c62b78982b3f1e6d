// SPDX-License-Identifier: Apache-2.0
#include "xauto/live.h"

#include <algorithm>
#include <chrono>
#include <thread>

#include <fmt/format.h>
#include <unistd.h>

#include "base/columns.h"
#include "base/log.h"
#include "coord/protocol.h"
#include "launch/supervisor.h"
#include "processes/marks.h"
#include "processes/parameters.h"

#include "xauto/asking.h"

namespace xauto::cli {
namespace {

constexpr int kAnswerMs = 1000, kDeskAnswerMs = 5000;  ///< the tool looks five times a second

/// `name` of one run, or with an empty name of all.
std::vector<RunSocket> sockets_of(const std::string& run, const std::string& name) {
  std::vector<RunSocket> sockets = run_sockets();
  std::erase_if(sockets, [&](const RunSocket& at) {
    return at.name != name || (!run.empty() && at.run != run);
  });
  return sockets;
}

Result<Watched> watched_of(const RunSocket& at, Result<Answer> answer) {
  if (!answer) return tl::unexpected<Error>(std::move(answer).error());
  if (answer->fds.size() != 1) return fail(ErrorCode::kInvalid, "did not pass its counts", at.run);
  const auto text = [&](const char* key) { return answer->said.at(key).text().value_or("?"); };
  Watched watched{at.run,           text("app"),
                  text("platform"), text("scheduling"),
                  answer->uid,      answer->said.at("host").text().value_or(""),
                  nullptr};
  XAUTO_ASSIGN(watched.board, runtime::Board::observe(answer->fds[0].get()));
  return watched;
}

/// Who introduces a run answers unasked and hangs up. A question that it leaves unread would make
/// the kernel reset the connection, and the answer would be lost to whoever reads it a bit late.
std::vector<Result<Watched>> introduce(const std::vector<RunSocket>& sockets) {
  std::vector<Result<Answer>> answers = ask(sockets, {}, kAnswerMs);
  std::vector<Result<Watched>> runs;
  for (std::size_t i = 0; i < sockets.size(); ++i)
    runs.push_back(watched_of(sockets[i], std::move(answers[i])));
  return runs;
}

/// The one that is meant, of those that were asked: the user's own, or the only other one.
Result<Watched> choose(std::vector<Result<Watched>> runs) {
  const bool has_own = std::any_of(runs.begin(), runs.end(), [](const Result<Watched>& run) {
    return run && run->uid == geteuid();
  });
  std::erase_if(
      runs, [&](const Result<Watched>& run) { return has_own && (!run || run->uid != geteuid()); });
  const auto begins = std::stable_partition(
      runs.begin(), runs.end(), [](const Result<Watched>& run) { return run.has_value(); });
  const auto there = begins - runs.begin();
  if (there == 1 || (there == 0 && runs.size() == 1)) return std::move(runs.front());
  if (there == 0) return fail(ErrorCode::kNotFound, "no run that can be asked is going on");
  std::string list;
  for (auto run = runs.begin(); run != begins; ++run)
    list += " " + (*run)->run + (has_own ? "" : " of " + user_name((*run)->uid));
  return fail(ErrorCode::kInvalid, "several runs are going on:" + list, "--run", "name one");
}

}  // namespace

std::vector<std::string> running() {
  std::vector<std::string> runs;
  for (const RunSocket& at : sockets_of({}, launch::kLiveName)) runs.push_back(at.run);
  return runs;
}

std::vector<Watched> introduced(const std::vector<std::string>& runs) {
  std::vector<RunSocket> sockets = sockets_of({}, launch::kLiveName);
  std::erase_if(sockets, [&](const RunSocket& at) {
    return std::find(runs.begin(), runs.end(), at.run) == runs.end();
  });
  std::vector<Watched> all;
  for (Result<Watched>& run : introduce(sockets))
    if (run) all.push_back(std::move(*run));
  return all;
}

Result<Watched> watch(const std::string& run, int wait_s, const std::atomic<bool>& stop) {
  const auto limit = std::chrono::steady_clock::now() + std::chrono::seconds(wait_s);
  for (;;) {
    const std::vector<RunSocket> sockets = sockets_of(run, launch::kLiveName);
    Result<Watched> watched =
        sockets.empty()
            ? fail(ErrorCode::kNotFound,
                   run.empty() ? "no run is going on" : "no run '" + run + "' is going on", "--run",
                   "start `xauto run ...`, then this, or see --wait; runs of other users, "
                   "containers and network namespaces are not seen")
            : choose(introduce(sockets));
    const bool several = !watched && run.empty() && watched.error().code == ErrorCode::kInvalid;
    if (watched || several || stop.load() || std::chrono::steady_clock::now() >= limit)
      return watched;
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
}

Result<Watched> find_run(const std::string& name, int wait_s) {
  const std::atomic<bool> never{false};
  return watch(name, wait_s, never);
}

Result<Json> ask_desk(const Watched& run, const Json& request) {
  const std::string where = "run '" + run.run + "'";
  const std::string text = request.dump();
  if (text.size() > runtime::kMaxParameterRequest)
    return fail(ErrorCode::kInvalid, "these values are too long to be set at once", where,
                "set some of them, then the others");
  Result<Answer> answer = fail(ErrorCode::kUnavailable, "is at its end", where);
  for (Result<Answer>& one : ask(sockets_of(run.run, launch::kDeskName), text, kDeskAnswerMs, true))
    if (!answer || (one && one->uid == run.uid)) answer = std::move(one);
  if (!answer && answer.error().code == ErrorCode::kTimeout)
    return fail(ErrorCode::kTimeout, "did not answer within 5 s", where, "ask what holds now");
  if (!answer && answer.error().code == ErrorCode::kUnavailable)
    return fail(ErrorCode::kUnavailable, "hung up without an answer; it may be at its end", where);
  if (!answer) return tl::unexpected<Error>(std::move(answer).error());
  if (Status status = runtime::answer_error(answer->said.dump()); !status) {
    Error error = std::move(status).error();
    error.where = where + (error.where.empty() ? "" : ", " + error.where);
    return tl::unexpected<Error>(std::move(error));
  }
  return answer->said.at("was");
}

std::map<std::string, Coordinated> ask_coordinators(const std::string& run) {
  std::vector<RunSocket> sockets = run_sockets();
  std::erase_if(sockets, [&](const RunSocket& at) {
    return (!run.empty() && at.run != run) || at.name == launch::kEmudName ||
           at.name == launch::kHubName || at.name == launch::kLiveName ||
           at.name == launch::kDeskName || at.name.starts_with(runtime::kMark);
  });
  const auto kind = static_cast<std::uint32_t>(coord::MessageKind::kStatus);
  const std::string question(reinterpret_cast<const char*>(&kind), sizeof kind);
  std::map<std::string, Coordinated> runs;
  std::vector<Result<Answer>> answers = ask(sockets, question, kAnswerMs);
  for (std::size_t i = 0; i < sockets.size(); ++i) {
    const auto xpu =
        answers[i].and_then([](const Answer& answer) { return parse_xpu_status(answer.said); });
    if (xpu) {
      Coordinated& of = runs[sockets[i].run];
      of.uid = answers[i]->uid;
      of.xpus.push_back(*xpu);
    } else {  // it ended between the look at the table and the question
      log::debug("{}", xpu.error().to_string());
    }
  }
  return runs;
}

std::string claims_text(const Counts& counts) {
  if (!counts.account.claims()) return {};
  const bool stands = counts.account.verdict() == runtime::Verdict::kKept;
  std::string out =
      "\n" + row_of("reaction, ms", kNameColumns) +
      fmt::format("{:>9}{:>9}{:>12}{:>9}\n", "last", "longest", "worst case", "bound");
  const auto claim = [&](std::int64_t us) {
    return us == 0 ? "-" : (stands ? "" : "*") + ms_in_row(us);
  };
  for (const FlowCounts& chain : counts.chains) {
    out += row_of(chain.name, kNameColumns) +
           fmt::format("{:>9}{:>9}{:>12}{:>9}\n", ms_in_row(chain.last_us),
                       ms_in_row(chain.longest_us), claim(chain.worst_case_us),
                       chain.lower_bound_us == 0 ? "-" : ms_in_row(chain.lower_bound_us));
    if (chain.urgent_worst_case_us > 0)
      out += row_of("  urgent", kNameColumns) + fmt::format("{:>18}{:>12}\n",
                                                            ms_in_row(chain.longest_urgent_us),
                                                            claim(chain.urgent_worst_case_us));
  }
  return out + fmt::format("  {}worst cases, so far: {}\n", stands ? "" : "* ",
                           counts.account.verdict_words());
}

std::string Live::xnode_of(std::uint64_t job) const {
  const std::uint64_t number = job >> XAUTO_BPF_JOB_SHIFT;
  if (number == 0 || number > names.size() || (job & XAUTO_BPF_JOB_SEQ) == XAUTO_BPF_JOB_EXPECTED)
    return "-";
  return names[number - 1].xnode;
}

Result<Live> observe(const std::string& run, const kernel::TracerOptions& options) {
  XAUTO_TRY(kernel::bpf_is_built_in());
  const std::vector<std::string> runs = kernel::RunMaps::runs();
  if (std::find(runs.begin(), runs.end(), run) == runs.end())
    return fail(ErrorCode::kNotFound, "run '" + run + "' has no maps", XAUTO_BPF_ROOT,
                "who traces and who has started `xauto run` must be root");
  // The folder is there before its last file, and that before the maps are filled.
  Result<kernel::RunMaps> maps = kernel::RunMaps::open(run);
  for (int again = 0; again < 50 && !maps && maps.error().code == ErrorCode::kNotFound; ++again) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    maps = kernel::RunMaps::open(run);
  }
  if (!maps) return tl::unexpected<Error>(std::move(maps).error());
  XAUTO_ASSIGN(kernel::Tracer tracer, kernel::Tracer::attach(*maps, options));
  std::vector<kernel::XNodeName> names = maps->names();
  return Live{std::move(*maps), std::move(names), std::move(tracer)};
}

XNodeNumbers numbers_of(const xauto_bpf_hist& now, const xauto_bpf_hist& before) {
  xauto_bpf_hist d{};
  for (int i = 0; i < XAUTO_BPF_BUCKETS; ++i) {
    d.latency[i] = now.latency[i] - before.latency[i];
    d.run[i] = now.run[i] - before.run[i];
    d.wait[i] = now.wait[i] - before.wait[i];
  }
  XNodeNumbers n;
  n.jobs = now.jobs - before.jobs;
  n.wakeups = now.wakeups - before.wakeups;
  n.preemptions = now.preemptions - before.preemptions;
  n.migrations = now.migrations - before.migrations;
  const auto any = [](const auto& buckets) {
    return std::any_of(std::begin(buckets), std::end(buckets), [](__u64 k) { return k != 0; });
  };
  const auto quantile = [&](const auto& buckets, int permille) {
    return any(buckets) ? static_cast<std::int64_t>(kernel::quantile_us(buckets, permille)) : -1;
  };
  n.latency_p50_us = quantile(d.latency, 500);
  n.latency_p99_us = quantile(d.latency, 990);
  if (any(now.latency)) n.latency_max_us = static_cast<std::int64_t>(now.latency_max_ns / 1000);
  n.run_p50_us = quantile(d.run, 500);
  n.run_p99_us = quantile(d.run, 990);
  n.wait_p99_us = quantile(d.wait, 990);
  n.run_ms = static_cast<double>(now.run_ns - before.run_ns) * 1e-6;
  n.wait_ms = static_cast<double>(now.wait_ns - before.wait_ns) * 1e-6;
  return n;
}

Json measured(std::int64_t us) {
  return us < 0 ? Json() : Json(us);
}
std::string measured_text(std::int64_t us) {
  return us < 0 ? "-" : std::to_string(us);
}

}  // namespace xauto::cli
