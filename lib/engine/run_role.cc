// SPDX-License-Identifier: Apache-2.0
#include "engine/run_role.h"

#include <algorithm>
#include <cstdlib>
#include <map>
#include <set>
#include <string>
#include <vector>

#include <fcntl.h>
#include <uapi/xauto/event.h>

#include "account/ledger.h"
#include "base/check.h"
#include "base/log.h"
#include "grid/context.h"
#include "processes/hub.h"
#include "processes/member.h"
#include "processes/stand_in.h"
#include "runtime/wiring.h"
#include "session/notes.h"

namespace xauto::runtime {
namespace {

class Alone final : public RunRole {
 public:
  explicit Alone(std::shared_ptr<Board> board) : board_(std::move(board)) {}
  const std::shared_ptr<Board>& board() const override { return board_; }
  transport::Link& link(std::size_t) const override {
    XAUTO_CHECK(false);  // no topic leaves the only process
    std::abort();
  }
  void attach(const Context&, Wiring&, Ledger&) override {}

 private:
  std::shared_ptr<Board> board_;
};

class Leader final : public RunRole, private HubHost {
 public:
  static Result<std::unique_ptr<RunRole>> make(const Graph& graph, const Plan& plan,
                                               const Session& session, std::size_t flows,
                                               std::atomic<bool>& stop) {
    auto leader = std::unique_ptr<Leader>(new Leader(stop));
    XAUTO_ASSIGN(leader->hub_, Hub::create(plan, graph, session, flows, *leader));
    return std::unique_ptr<RunRole>(std::move(leader));
  }

  const std::shared_ptr<Board>& board() const override { return hub_->board(); }
  transport::Link& link(std::size_t topic) const override { return hub_->topic(topic); }
  void attach(const Context& context, Wiring& wiring, Ledger& ledger) override {
    context_ = &context;
    wiring_ = &wiring;
    ledger_ = &ledger;
  }

  Result<bool> begin() override {
    XAUTO_TRY(wiring_->open_inputs());
    return hub_->wait_ready(stop_);
  }

  void end() override {
    reports_ = hub_->stop();
    wiring_->close_inputs();
  }

  /// Adds what the members have to tell. The counts are on the board, the latencies came with
  /// events.
  void gather(RunReport& report) const override {
    const auto note = [&](const std::string& text) {
      if (report.note.find(text) == std::string::npos) add_note(report.note, text);
    };
    std::set<std::string> lost(report.lost_coordinators.begin(), report.lost_coordinators.end());
    for (const std::string& text : reports_) {
      const auto member = parse_run_report(text);
      if (!member) {
        note("a module process's report is unreadable");
        continue;
      }
      note(member->note);
      Account& of = report.account;
      of.taken.insert(of.taken.end(), member->account.taken.begin(), member->account.taken.end());
      if (of.not_watched.empty()) of.not_watched = member->account.not_watched;
      lost.insert(member->lost_coordinators.begin(), member->lost_coordinators.end());
    }
    report.lost_coordinators.assign(lost.begin(), lost.end());
    for (const int process : hub_->deaths())
      for (const std::string& module :
           context_->session.parts.modules[static_cast<std::size_t>(process - 1)])
        report.died.push_back(module);
    if (const std::uint64_t missed = wiring_->receiver()->lost(); missed > 0)
      add_note(report.note,
               std::to_string(missed) + " messages to this process were lost in full queues");
  }

  bool look_after(int process, std::int64_t silence_ns) override {
    std::int64_t& silence = silence_ns_[process];
    silence = std::max(silence, silence_ns);
    return true;
  }

  /// A process that has stopped as a whole cannot tell that it hangs.
  void looked(std::int64_t now) override {
    for (const auto& [process, silence] : silence_ns_) {
      std::atomic<std::int64_t>& watched = board()->process(process).watched_ns;
      const std::int64_t last = watched.load();
      if (last == 0 || now - last <= silence) continue;
      watched.store(0);  // of this one; the next starts anew
      log::error("process {} has not looked after itself for {} ms: it is killed", process,
                 (now - last) / 1'000'000);
      hub_->kill(process);
    }
  }

 private:
  explicit Leader(std::atomic<bool>& stop) : stop_(stop) {}

  // HubHost, on the hub's thread. Members run, so everything is attached.
  void event(const Packet& packet) override {
    ledger_->through(static_cast<int>(packet.index), packet.sequence, packet.origin_ns,
                     packet.rates != 0 ? &packet.origins : nullptr, packet.now_ns, packet.lost != 0,
                     packet.urgent != 0);
  }

  void left(int process) override {
    const Graph& graph = context_->graph;
    std::string modules;
    for (std::size_t m = 0; m < graph.modules.size(); ++m) {
      if (context_->plan.process_of[m] != process) continue;
      modules += (modules.empty() ? "" : ", ") + graph.modules[m].name;
      board()->module(static_cast<int>(m)).deaths.fetch_add(1, std::memory_order_relaxed);
      ledger_->forget(static_cast<int>(m));
    }
    log::warn("the process of {} died: its activations are dropped", modules);
    auto stand_in = StandIn::take_over(process, context_->plan, graph, *hub_, *wiring_->receiver(),
                                       [this](int module, std::uint64_t sequence) {
                                         ledger_->dropped(module, sequence, XAUTO_DROP_DIED);
                                       });
    if (!stand_in) {
      log::error("cannot stand in for it: {}", stand_in.error().to_string());
      stop_.store(true);
      return;
    }
    stand_ins_[process] = std::move(*stand_in);
    board()->process(process).stand_in.store(0);
    board()->process(0).doorbell.ring();
  }

  void joins(int process) override {
    wiring_->receiver()->remove(process);
    stand_ins_.erase(process);
    board()->process(process).stand_in.store(static_cast<std::uint32_t>(process));
  }

  std::atomic<bool>& stop_;
  const Context* context_ = nullptr;
  Wiring* wiring_ = nullptr;
  Ledger* ledger_ = nullptr;
  std::vector<std::string> reports_;                   ///< of members, after `end`
  std::map<int, std::int64_t> silence_ns_;             ///< by process, after which it is killed
  std::map<int, std::unique_ptr<StandIn>> stand_ins_;  ///< by process; of the hub's thread
  std::unique_ptr<Hub> hub_;  ///< last: its thread ends before what it uses
};

class Follower final : public RunRole {
 public:
  static Result<std::unique_ptr<RunRole>> make(const Graph& graph, const Plan& plan,
                                               const Session& session, std::size_t flows,
                                               const std::atomic<bool>& stop) {
    auto follower = std::unique_ptr<Follower>(new Follower(stop));
    XAUTO_ASSIGN(follower->member_, Member::join(plan, graph, session, flows));
    return std::unique_ptr<RunRole>(std::move(follower));
  }

  const std::shared_ptr<Board>& board() const override { return member_->board(); }
  bool leads() const override { return false; }
  transport::Link& link(std::size_t topic) const override { return member_->topic(topic); }
  void attach(const Context& context, Wiring& wiring, Ledger&) override {
    context_ = &context;
    wiring_ = &wiring;
  }

  /// After a death the modules begin where the hub left off.
  Result<bool> begin() override {
    XAUTO_ASSIGN(const bool go, member_->ready(stop_));
    if (!go) return false;
    for (std::size_t m = 0; m < context_->graph.modules.size(); ++m) {
      ModuleRuntime* module = wiring_->module(m);
      if (module == nullptr || !context_->graph.modules[m].numbered) continue;
      const std::uint64_t next = board()->module(static_cast<int>(m)).settled();
      module->begin_at(next);
      if (next > 0) wiring_->skip(static_cast<int>(m), next - 1);
    }
    XAUTO_TRY(wiring_->open_inputs());
    return true;
  }
  Status wait_stop() override {
    if (member_->wait_stop(stop_)) return {};
    return fail(ErrorCode::kUnavailable, "the app's hub is gone",
                "app '" + context_->app.name + "'");
  }
  void end() override { wiring_->close_inputs(); }
  void hand_over(const RunReport& report) override { member_->report(to_json(report)); }

  bool tell(int module, std::uint64_t sequence, std::int64_t origin_ns, std::int64_t now_ns,
            bool lost, const detail::Origins* origins, bool urgent) override {
    member_->tell(module, sequence, origin_ns, now_ns, lost, origins, urgent);
    return true;
  }
  void looked(std::int64_t now) override {
    board()->process(context_->session.parts.process).watched_ns.store(now);
  }

 private:
  explicit Follower(const std::atomic<bool>& stop) : stop_(stop) {}
  const std::atomic<bool>& stop_;
  const Context* context_ = nullptr;
  Wiring* wiring_ = nullptr;
  std::unique_ptr<Member> member_;
};

}  // namespace

Result<std::unique_ptr<RunRole>> RunRole::of(const Graph& graph, const Plan& plan,
                                             const Session& session, std::size_t flows,
                                             std::atomic<bool>& stop) {
  if (plan.processes == 1) {
    const BoardShape shape = shape_of(plan, graph, session, flows);
    if (session.board_fd < 0)
      return std::unique_ptr<RunRole>(std::make_unique<Alone>(Board::local(shape)));
    UniqueFd fd(fcntl(session.board_fd, F_DUPFD_CLOEXEC, 3));
    XAUTO_ASSIGN(std::shared_ptr<Board> board, Board::create(shape, fd));
    return std::unique_ptr<RunRole>(std::make_unique<Alone>(std::move(board)));
  }
  return session.parts.process == 0 ? Leader::make(graph, plan, session, flows, stop)
                                    : Follower::make(graph, plan, session, flows, stop);
}

}  // namespace xauto::runtime
