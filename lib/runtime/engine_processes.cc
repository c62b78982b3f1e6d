// SPDX-License-Identifier: Apache-2.0
// An app in several processes: the topics between them, the hub's side of their deaths and returns,
// and a member's run. See isolation.h.
#include <set>

#include "base/clock.h"
#include "base/log.h"
#include "base/rt.h"
#include "runtime/engine.h"
#include "runtime/notes.h"

namespace xauto::runtime {

transport::Link& Engine::link(std::size_t topic) const {
  return hub_ ? hub_->topic(topic) : member_->topic(topic);
}

/// What this process publishes to others.
Status Engine::open_topics() {
  publishers_.resize(graph_.topics.size());
  for (std::size_t t = 0; t < graph_.topics.size(); ++t) {
    const Plan::Remote& remote = plan_.topics[t];
    if (remote.readers.empty() || remote.publisher != session_.process) continue;
    ringers_.push_back(std::make_unique<BoardRinger>(board_, remote.readers));
    XAUTO_ASSIGN(publishers_[t], link(t).publisher(graph_.topics[t].spec, ringers_.back().get()));
  }
  return {};
}

/// What this process reads of others. From here on messages come in.
Status Engine::open_inputs() {
  if (plan_.processes == 1) return {};
  receiver_ = std::make_unique<transport::Receiver>(board_->process(session_.process).doorbell);
  for (std::size_t t = 0; t < graph_.topics.size(); ++t) {
    const int reader = plan_.topics[t].reader(session_.process);
    if (reader < 0) continue;
    XAUTO_ASSIGN(auto subscriber,
                 link(t).subscriber(graph_.topics[t].spec, static_cast<std::uint32_t>(reader)));
    receiver_->add(-1, std::move(subscriber), false,
                   [channel = &channels_[t]](const detail::Envelope& envelope) {
                     channel->publish(envelope);
                   });
  }
  receiver_->start([priority = fifo_.sources] {
    rt::set_thread_name("xauto/topics");
    rt::set_timer_slack_1ns();
    if (priority > 0) (void)rt::set_fifo(priority);
  });
  return {};
}

void Engine::event(const Packet& packet) {
  through(static_cast<int>(packet.index), packet.sequence, packet.origin_ns,
          packet.rates != 0 ? &packet.origins : nullptr, packet.now_ns, packet.lost != 0);
}

void Engine::left(int process) {
  std::string modules;
  for (std::size_t m = 0; m < graph_.modules.size(); ++m) {
    if (plan_.process_of[m] != process) continue;
    modules += (modules.empty() ? "" : ", ") + graph_.modules[m].name;
    board_->module(static_cast<int>(m)).in_flight.store(0);
    // It may have died between counting a release and telling.
    const std::uint64_t settled = board_->module(static_cast<int>(m)).settled();
    if (graph_.modules[m].sink && graph_.single_rate && settled > 0)
      account(static_cast<int>(m), settled - 1, now_ns(), true);
  }
  log::warn("the process of {} died: its activations are dropped", modules);
  auto ghost = Ghost::haunt(
      process, plan_, graph_, *hub_, *receiver_,
      [this](int module, std::uint64_t sequence) { dropped(module, sequence, XAUTO_DROP_DIED); });
  if (!ghost) {
    log::error("cannot stand in for it: {}", ghost.error().to_string());
    stop_.store(true);
    return;
  }
  ghosts_[process] = std::move(*ghost);
  board_->process(process).stand_in.store(0);
  board_->process(0).doorbell.ring();
}

void Engine::joins(int process) {
  receiver_->remove(process);
  ghosts_.erase(process);
  board_->process(process).stand_in.store(static_cast<std::uint32_t>(process));
}

Result<RunReport> Engine::run_member() {
  XAUTO_ASSIGN(const bool go, member_->ready(stop_));
  if (go) {
    if (graph_.single_rate)
      for (std::size_t m = 0; m < modules_.size(); ++m)
        if (modules_[m] != nullptr) {
          const std::uint64_t next = board_->module(static_cast<int>(m)).settled();
          modules_[m]->begin_at(next);
          if (next > 0) skip(static_cast<int>(m), next - 1);
        }
    XAUTO_TRY(open_inputs());
    if (!member_->wait_stop(stop_))
      return fail(ErrorCode::kUnavailable, "the app's hub is gone", "app '" + app_.name + "'");
  }
  if (receiver_) receiver_->stop();
  stop_workers();
  RunReport result;  // the counts are on the board
  tell_notes(result);
  member_->report(to_json(result));
  return result;
}

/// Adds what the members have to tell. The counts are on the board, the latencies came with events.
void Engine::gather(const std::vector<std::string>& reports, RunReport& report) const {
  const auto note = [&](const std::string& text) {
    if (report.note.find(text) == std::string::npos) add_note(report.note, text);
  };
  std::set<std::string> lost(report.lost_coordinators.begin(), report.lost_coordinators.end());
  for (const std::string& text : reports) {
    const auto member = parse_run_report(text);
    if (!member) {
      note("a module process's report is unreadable");
      continue;
    }
    note(member->note);
    lost.insert(member->lost_coordinators.begin(), member->lost_coordinators.end());
  }
  report.lost_coordinators.assign(lost.begin(), lost.end());
  for (const int process : hub_->deaths())
    for (const std::string& module : session_.processes[static_cast<std::size_t>(process - 1)])
      report.died.push_back(module);
}

}  // namespace xauto::runtime
