// SPDX-License-Identifier: Apache-2.0
#include "xauto/live.h"

#include <algorithm>
#include <chrono>
#include <thread>

#include <fmt/format.h>
#include <pwd.h>
#include <sys/socket.h>
#include <unistd.h>

#include "base/log.h"
#include "base/socket.h"
#include "coord/protocol.h"
#include "launch/supervisor.h"
#include "processes/parameters.h"

#include "xauto/verdict.h"

namespace xauto::cli {
namespace {

constexpr int kAnswerTimeoutMs = 1000;

/// One packet of JSON from a peer, with what comes along.
Result<Json> answer_of(int socket, const std::string& address,
                       std::vector<UniqueFd>* fds = nullptr) {
  if (!wait_readable(socket, kAnswerTimeoutMs))
    return fail(ErrorCode::kTimeout, "did not answer within 1 s", address);
  std::string text(coord::kMaxStatusBytes, '\0');
  XAUTO_ASSIGN(const std::size_t size, receive_packet(socket, text.data(), text.size(), fds));
  std::optional<Json> parsed = Json::parse(std::string_view(text).substr(0, size));
  if (!parsed || !parsed->is_object())
    return fail(ErrorCode::kInvalid, "answered with something else than a status", address);
  return *std::move(parsed);
}

/// A coordinator is asked by one word.
Result<Json> ask(const std::string& address) {
  XAUTO_ASSIGN(const UniqueFd socket, connect_abstract(address));
  const auto kind = static_cast<std::uint32_t>(coord::MessageKind::kStatus);
  XAUTO_TRY(send_packet(socket.get(), &kind, sizeof kind));
  return answer_of(socket.get(), address);
}

/// Who introduces a run answers unasked and hangs up. A question that it leaves unread would make
/// the kernel reset the connection, and the answer would be lost to whoever reads it a bit late.
Result<Watched> introduced(const std::string& run) {
  const std::string address = address_of(run, launch::kLiveName);
  XAUTO_ASSIGN(const UniqueFd socket, connect_abstract(address));
  std::vector<UniqueFd> fds;
  XAUTO_ASSIGN(const Json hello, answer_of(socket.get(), address, &fds));
  if (fds.size() != 1) return fail(ErrorCode::kInvalid, "did not pass its counts", run);
  const auto text = [&](const char* key) { return hello.at(key).text().value_or("?"); };
  Watched watched{run, text("app"), text("platform"), text("scheduling"), nullptr};
  XAUTO_ASSIGN(watched.board, runtime::Board::observe(fds[0].get()));
  return watched;
}

}  // namespace

std::string address_of(const std::string& run, const std::string& name) {
  return launch::kSocketPrefix + run + "/" + name;
}

std::string user_name(unsigned uid) {
  const passwd* entry = getpwuid(uid);
  return entry != nullptr ? entry->pw_name : "uid " + std::to_string(uid);
}

std::vector<std::string> running() {
  std::vector<std::string> runs;
  const std::string prefix = launch::kSocketPrefix;
  const std::string suffix = std::string("/") + launch::kLiveName;
  for (const std::string& address : abstract_sockets(prefix))
    if (address.ends_with(suffix) && address.size() > prefix.size() + suffix.size())
      runs.push_back(address.substr(prefix.size(), address.size() - prefix.size() - suffix.size()));
  return runs;
}

Result<Watched> watch(const std::string& run, int wait_s, const std::atomic<bool>& stop) {
  const auto limit = std::chrono::steady_clock::now() + std::chrono::seconds(wait_s);
  for (;;) {
    const std::vector<std::string> runs = running();
    if (run.empty() && runs.size() > 1) {
      std::string list;
      for (const std::string& one : runs) list += " " + one;
      return fail(ErrorCode::kInvalid, "several runs are going on:" + list, "--run", "name one");
    }
    const bool there =
        run.empty() ? runs.size() == 1 : std::find(runs.begin(), runs.end(), run) != runs.end();
    Result<Watched> watched = fail(
        ErrorCode::kNotFound,
        run.empty() ? "no run is going on" : "no run '" + run + "' is going on", "--run",
        "start `xauto run ...`, then this, or see --wait-s; runs of other users, containers and "
        "network namespaces are not seen");
    if (there) watched = introduced(run.empty() ? runs.front() : run);
    if (watched || stop.load() || std::chrono::steady_clock::now() >= limit) return watched;
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
}

namespace {

constexpr int kAnswerMs = 5000;  ///< the run's tool looks at least five times a second

/// Of a run of somebody else's: nobody would answer.
Status may_ask(int socket, const std::string& run) {
  ucred peer{};
  socklen_t size = sizeof peer;
  if (getsockopt(socket, SOL_SOCKET, SO_PEERCRED, &peer, &size) != 0 || geteuid() == 0 ||
      peer.uid == geteuid())
    return {};
  return fail(
      ErrorCode::kPermission,
      "run '" + run + "' is of " + user_name(peer.uid) + ", and answers only that user and root",
      "--run", "ask as that user, or with sudo");
}

}  // namespace

Status not_of_others(const std::string& name) {
  const std::vector<std::string> runs = running();
  const std::string run = name.empty() && runs.size() == 1 ? runs.front() : name;
  if (run.empty()) return {};
  const auto socket = connect_abstract(address_of(run, launch::kLiveName));
  return socket ? may_ask(socket->get(), run) : Status();
}

Result<Watched> find_run(const std::string& name, int wait_s) {
  const std::atomic<bool> never{false};
  auto watched = watch(name, wait_s, never);
  if (!watched) XAUTO_TRY(not_of_others(name));
  return watched;
}

std::vector<std::string> ours() {
  std::vector<std::string> runs = running();
  std::erase_if(runs, [](const std::string& run) {
    const auto socket = connect_abstract(address_of(run, launch::kLiveName));
    return !socket || !may_ask(socket->get(), run);  // it has just ended, or is somebody else's
  });
  return runs;
}

Result<Json> ask_desk(const Watched& run, const Json& request) {
  const std::string where = "run '" + run.run + "'";
  const std::string text = request.dump();
  if (text.size() > runtime::kMaxParameterRequest)
    return fail(ErrorCode::kInvalid, "these values are too long to be set at once", where,
                "set some of them, then the others");
  XAUTO_ASSIGN(const UniqueFd socket, connect_abstract(address_of(run.run, launch::kDeskName)));
  XAUTO_TRY(may_ask(socket.get(), run.run));
  XAUTO_TRY(send_packet(socket.get(), text.data(), text.size()));
  if (!wait_readable(socket.get(), kAnswerMs))
    return fail(ErrorCode::kTimeout, "did not answer within 5 s", where, "ask what holds now");
  std::string answer(runtime::kMaxParameterAnswer, '\0');
  const auto size = receive_packet(socket.get(), answer.data(), answer.size());
  if (!size)
    return fail(ErrorCode::kUnavailable, "hung up without an answer; it may be at its end", where);
  answer.resize(*size);
  if (Status status = runtime::answer_error(answer); !status) {
    Error error = std::move(status).error();
    error.where = where + (error.where.empty() ? "" : ", " + error.where);
    return tl::unexpected<Error>(std::move(error));
  }
  return Json::parse(answer)->at("was");
}

std::vector<XpuStatus> ask_coordinators(const std::string& run) {
  std::vector<XpuStatus> answers;
  for (const std::string& address : abstract_sockets(address_of(run, ""))) {
    const std::string name = address.substr(address.rfind('/') + 1);
    if (name == launch::kEmudName || name == launch::kHubName || name == launch::kLiveName ||
        name == launch::kDeskName)
      continue;
    auto answer = ask(address).and_then(parse_xpu_status);
    if (answer)
      answers.push_back(std::move(*answer));
    else  // it ended between the look at the table and the question
      log::debug("{}", answer.error().to_string());
  }
  return answers;
}

std::string claims_text(const Counts& counts) {
  if (!counts.claims.claimed) return {};
  const bool stands = counts.claims.kept();
  const auto in_ms = [](std::int64_t us) {
    return us < 0 ? std::string("-") : fmt::format("{:.2f}", static_cast<double>(us) / 1000);
  };
  std::string out = fmt::format("\n  {:<28}{:>9}{:>9}{:>12}{:>9}\n", "reaction, ms", "last",
                                "longest", "worst case", "bound");
  const auto claim = [&](std::int64_t us) {
    return us == 0 ? "-" : (stands ? "" : "*") + in_ms(us);
  };
  const auto add = [&](const std::string& name, const FlowCounts& flow) {
    out += fmt::format("  {:<28}{:>9}{:>9}{:>12}{:>9}\n", name, in_ms(flow.last_us),
                       in_ms(flow.longest_us), claim(flow.worst_case_us),
                       flow.lower_bound_us == 0 ? "-" : in_ms(flow.lower_bound_us));
  };
  for (const ScenarioCounts& s : counts.scenarios)
    out += fmt::format("  {:<28}{:>9}{:>9}{:>12}{:>9}\n", "scenario '" + s.name + "'", "",
                       in_ms(s.longest_us), claim(s.worst_case_us), "-");
  const bool tables = !counts.scenarios.empty();
  if (counts.whole.worst_case_us > 0 && !tables) add("a release", counts.whole);
  for (const FlowCounts& chain : counts.chains) {
    if (tables && chain.worst_case_us == 0) continue;  // what is claimed is of releases
    add(chain.name, chain);
    if (chain.urgent_worst_case_us > 0)
      out += fmt::format("  {:<28}{:>9}{:>9}{:>12}\n", "  urgent", "",
                         in_ms(chain.longest_urgent_us), claim(chain.urgent_worst_case_us));
  }
  return out + fmt::format("  {}worst cases, so far: {}\n", stands ? "" : "* ",
                           verdict(counts.claims.exceeded, counts.claims.broken,
                                   {"what took time away from it is told when it ends"}));
}

bool Live::goes_on() const {
  const std::vector<std::string> runs = kernel::RunMaps::runs();
  return std::find(runs.begin(), runs.end(), maps.run()) != runs.end();
}

std::string Live::xnode_of(std::uint64_t job) const {
  const std::uint64_t number = job >> XAUTO_BPF_JOB_SHIFT;
  if (number == 0 || number > names.size() || (job & XAUTO_BPF_JOB_SEQ) == XAUTO_BPF_JOB_EXPECTED)
    return "-";
  return names[number - 1].xnode;
}

Result<Live> observe(const std::string& run, int wait_s, const kernel::TracerOptions& options,
                     const std::atomic<bool>& stop) {
  XAUTO_TRY(kernel::bpf_is_built_in());
  std::string name = run;
  const auto limit = std::chrono::steady_clock::now() + std::chrono::seconds(wait_s);
  for (;;) {
    const std::vector<std::string> runs = kernel::RunMaps::runs();
    if (!run.empty() && std::find(runs.begin(), runs.end(), run) != runs.end()) break;
    if (run.empty() && runs.size() == 1) {
      name = runs.front();
      break;
    }
    if (run.empty() && runs.size() > 1) {
      std::string list;
      for (const std::string& one : runs) list += " " + one;
      return fail(ErrorCode::kInvalid, "several runs are going on:" + list, "--run", "name one");
    }
    if (stop.load() || std::chrono::steady_clock::now() >= limit)
      return fail(ErrorCode::kNotFound,
                  run.empty() ? "no run is going on that can be observed"
                              : "no run '" + run + "' is going on",
                  XAUTO_BPF_ROOT, "start `xauto run ...` as root, then this, or see --wait-s");
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  // The folder is there before its last file, and that before the maps are filled.
  Result<kernel::RunMaps> maps = kernel::RunMaps::open(name);
  for (int again = 0; again < 50 && !maps && maps.error().code == ErrorCode::kNotFound; ++again) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    maps = kernel::RunMaps::open(name);
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

std::string losses_line(const xauto_bpf_losses& losses, std::uint64_t not_kept) {
  if (losses.events + losses.pipe + losses.jobs + not_kept == 0)
    return fmt::format("complete: {} events, none lost", losses.written);
  std::string text = fmt::format("INCOMPLETE: of {} events {} were lost",
                                 losses.written + losses.events, losses.events + not_kept);
  if (losses.jobs > 0) text += fmt::format("; {} short jobs are in no histogram", losses.jobs);
  if (losses.pipe > 0) text += fmt::format("; a reader of the pipe missed {}", losses.pipe);
  if (losses.events > 0) text += " (--ring-kb makes the buffer larger)";
  return text;
}

}  // namespace xauto::cli
