// SPDX-License-Identifier: Apache-2.0
#include "releases/releaser.h"

#include <algorithm>
#include <set>
#include <thread>

#include <fmt/format.h>
#include <uapi/xauto/event.h>

#include "base/clock.h"
#include "base/log.h"
#include "base/rt.h"
#include "base/thread.h"
#include "record/xauto_msgs.h"
#include "runtime/shown_table.h"

namespace xauto::runtime {
namespace {

/// Longer than any run, and a sum of two of them is no overflow.
constexpr std::int64_t kForeverNs = INT64_MAX / 4;

}  // namespace

Result<std::unique_ptr<Releaser>> Releaser::make(const Context& context, Wiring& wiring,
                                                 Ledger& ledger, const std::atomic<bool>& stop) {
  auto releaser = std::unique_ptr<Releaser>(new Releaser(context, wiring, ledger, stop));
  XAUTO_ASSIGN(releaser->recorder_, RunRecorder::open(context, wiring));
  if (releaser->recorder_) releaser->notes_ = releaser->recorder_->notes();
  XAUTO_ASSIGN(releaser->tables_, TableSwitch::make(
                                      context, ledger,
                                      [&wiring](std::int64_t now_ns) {
                                        for (const auto& worker : wiring.workers())
                                          worker->times().tell_time(now_ns);
                                      },
                                      shower_of_tables(context.session)));
  return releaser;
}

Status Releaser::run(int fifo) {
  Status status;
  XAUTO_ASSIGN(std::thread thread, start_thread([&] { status = run_here(fifo); }));
  thread.join();
  if (tables_) tables_->give_away();
  return status;
}

Status Releaser::run_here(int fifo) {
  rt::set_thread_name("xauto/sources");
  rt::set_timer_slack_1ns();
  if (fifo > 0) (void)rt::set_fifo(fifo);
  using Keep = detail::Inlet::Keep;
  inlets_.emplace(context_.app, context_.session.releases.input.empty() ? Keep::kAll : Keep::kNone);
  if (Status opened = open_feeds(fifo); !opened) {
    inlets_.reset();
    return opened;
  }
  open_for_urgent();
  if (context_.session.releases.lockstep && context_.session.releases.input.empty() &&
      inlets_->any() && !context_.graph.single_rate)
    log::info(
        "in lockstep the releases of this app are at least 100 ms apart; what is published "
        "meanwhile waits its turn");
  Status status = detail::call(context_.app.on_start, "on_start", context_.app.name);
  if (status)
    status = !context_.session.releases.input.empty() ? release_recorded()
             : context_.grid.one_at_a_time            ? release_one_at_a_time()
                                                      : release_periodic();
  feeds_.reset();
  for (std::string& note : inlets_->close()) notes_.push_back(std::move(note));
  for (std::string& note : account_.notes()) notes_.push_back(std::move(note));
  inlets_.reset();
  const Status stopped = detail::call(context_.app.on_stop, "on_stop", context_.app.name);
  return status ? stopped : status;
}

/// An hour may lie between two releases: looks at `stop_` meanwhile.
void Releaser::sleep(std::int64_t until_ns) const {
  for (std::int64_t now = now_ns(); until_ns - now > kLookNs && !stop_.load(); now = now_ns())
    sleep_until_ns(now + kLookNs);
  if (!stop_.load()) sleep_until_ns(until_ns);
}

/// The next release does not come before the last one has ended.
bool Releaser::waits_for_the_last() const {
  return context_.session.releases.lockstep || context_.grid.one_at_a_time;
}

Status Releaser::drain() {
  if (!waits_for_the_last() || wait_drained()) return {};
  return fail(ErrorCode::kTimeout,
              context_.session.releases.lockstep
                  ? "no progress for 10 s in lockstep"
                  : "no progress for 10 s, and no source has a rate: the next release "
                    "waits for the end of the last one",
              "app '" + context_.app.name + "'");
}

/// A run by keys takes what is pushed, or fed, for releases of a grid.
bool Releaser::tracks() const {
  return context_.grid.periodic && !waits_for_the_last() && context_.session.releases.input.empty();
}

/// The source of `topic` releases when it likes to, and we follow.
bool Releaser::tracked(std::size_t topic) const {
  const auto source = static_cast<std::size_t>(context_.graph.topics[topic].source);
  return context_.app.sources[source].inlet != nullptr ||
         (tracks() && wiring_.interop() != nullptr && wiring_.interop()->feeds(topic));
}

Status Releaser::open_feeds(int fifo) {
  std::vector<Feeds::Feed> feeds;
  for (std::size_t t = 0; t < context_.graph.topics.size(); ++t) {
    const Graph::Topic& topic = context_.graph.topics[t];
    if (topic.source < 0) continue;
    const auto source = static_cast<std::size_t>(topic.source);
    if (context_.app.sources[source].inlet != nullptr || !tracked(t)) continue;
    const Grid::Source& grid = context_.grid.sources[source];
    feeds.push_back({t, &inlets_->add(source, topic.spec.name),
                     Pace(grid.period_ns(), grid.jitter_ns, context_.grid.clock_ppm[grid.clock])});
  }
  if (feeds.empty()) return {};
  XAUTO_ASSIGN(feeds_, Feeds::start(*wiring_.interop(), std::move(feeds), fifo));
  return {};
}

/// An urgent release is one of a policy of keys that counts with it.
bool Releaser::certifies_urgent(std::size_t source) const {
  return context_.session.keys && context_.scheduled() && tracks() &&
         context_.grid.sources[source].urgent_apart > 0;
}

/// Who runs the app in another way and claims nothing (lockstep) takes it for an ordinary one.
void Releaser::open_for_urgent() {
  if (context_.session.releases.lockstep || context_.session.mode != Mode::kRun) return;
  for (std::size_t s = 0; s < context_.app.sources.size(); ++s) {
    if (context_.app.sources[s].inlet == nullptr) continue;
    using Urgent = detail::Inlet::Urgent;
    context_.app.sources[s].inlet->take_urgent(certifies_urgent(s) ? Urgent::kTaken
                                                                   : Urgent::kRefused);
  }
}

/// What the program says of a message that it has not pushed itself.
Result<bool> Releaser::marked(std::size_t source, const void* message, std::uint64_t number) {
  const detail::SourceSpec& spec = context_.app.sources[source];
  if (!spec.urgent || message == nullptr || context_.session.releases.lockstep ||
      context_.session.mode != Mode::kRun)
    return false;
  bool says = false;
  try {
    says = spec.urgent(message, number);
  } catch (const std::exception& e) {
    return fail(ErrorCode::kUnavailable, std::string("threw: ") + e.what(),
                "what marks urgent messages of topic '" + spec.topic.name + "'");
  }
  if (!says || certifies_urgent(source)) return says;
  account_.unheard(source);
  return false;
}

/// Releases what is pushed until then; `once`: one message at most. False: the run is over.
Result<bool> Releaser::release_pushed(std::int64_t until_ns, bool once) {
  while (!stop_.load()) {
    const std::uint32_t seen = inlets_->pushes();
    const std::int64_t now = now_ns();  // what comes after this look comes later than this
    auto pushed = inlets_->take();
    if (!pushed) {
      if (tracks() && lose_overdue(now)) return false;
      if (now_ns() >= until_ns) return true;
      inlets_->wait(seen, std::min(until_ns, next_overdue_ns()));
      continue;
    }
    XAUTO_TRY(drain());
    const int t = context_.graph.topic_of_source[pushed->source];
    if (tracks()) {
      XAUTO_ASSIGN(const bool goes_on, release_tracked(t, pushed->waiting));
      if (!goes_on) return false;
    } else {
      std::uint64_t& number = pushed_[static_cast<std::size_t>(t)];
      // In lockstep waiting for its turn is no latency.
      release(context_.session.releases.lockstep ? now_ns() : pushed->waiting.at_ns,
              {{t, number++, std::move(pushed->waiting.message), 0}});
      if (counted_all(t)) return false;
    }
    // Whoever pushes without a pause must not hold it up.
    if (once || now_ns() >= until_ns) return true;
  }
  return false;
}

/// One more release of `topic`'s source. True: it was the run's last.
bool Releaser::counted_all(int topic) {
  return pushes_left_ > 0 && topic == slowest_source() && --pushes_left_ == 0;
}

/// Sensors that fell silent: their releases are lost as time goes on. True: the run is over.
bool Releaser::lose_overdue(std::int64_t now_ns) {
  for (std::size_t t = 0; t < context_.graph.topics.size(); ++t) {
    if (context_.graph.topics[t].source < 0 || !tracked(t)) continue;
    const auto source = static_cast<std::size_t>(context_.graph.topics[t].source);
    const Grid::Source& grid = context_.grid.sources[source];
    ClockPhase::Stream& stream = streams_[source];
    for (;;) {
      const auto limit = phases_[grid.clock]->left_out_ns(grid, stream);
      if (!limit || now_ns < *limit) break;
      leave_out(static_cast<int>(t), stream.next, now_ns);
      ClockPhase::leave_out(stream);
      if (counted_all(static_cast<int>(t))) return true;
    }
  }
  return false;
}

std::int64_t Releaser::next_overdue_ns() const {
  std::int64_t next_ns = INT64_MAX;
  for (std::size_t t = 0; tracks() && t < context_.graph.topics.size(); ++t) {
    if (context_.graph.topics[t].source < 0 || !tracked(t)) continue;
    const auto source = static_cast<std::size_t>(context_.graph.topics[t].source);
    const Grid::Source& grid = context_.grid.sources[source];
    if (const auto limit = phases_[grid.clock]->left_out_ns(grid, streams_[source]))
      next_ns = std::min(next_ns, *limit);
  }
  return next_ns;
}

/// What did not come is lost, and known to be: nobody waits for it.
void Releaser::leave_out(int topic, std::uint64_t number, std::int64_t at_ns) {
  account_.left_out(
      static_cast<std::size_t>(context_.graph.topics[static_cast<std::size_t>(topic)].source));
  release(at_ns, {{topic, number, nullptr, 0}});
}

/// As the release of the grid that it is, if it is one; behind those that it shows to be left out. False: the run is over.
Result<bool> Releaser::release_tracked(int topic, const detail::Inlet::Waiting& pushed) {
  const auto t = static_cast<std::size_t>(topic);
  const auto source = static_cast<std::size_t>(context_.graph.topics[t].source);
  const Grid::Source& grid = context_.grid.sources[source];
  ClockPhase::Stream& stream = streams_[source];
  std::uint64_t next = stream.next;
  const auto found = phases_[grid.clock]->arrived(pushed.at_ns, grid, stream);
  if (!found) return true;
  for (; next < found->number; ++next) {
    leave_out(topic, next, pushed.at_ns);
    if (counted_all(topic)) return false;
  }
  account_.came(source, pushed.at_ns, found->off_ns, found->early);
  XAUTO_ASSIGN(const bool fed, marked(source, pushed.message.get(), found->number));
  const bool is_urgent = (pushed.urgent || fed) && account_.urgent(source, found->number);
  release(pushed.at_ns, {{topic, found->number, pushed.message, found->nominal_ns, is_urgent}});
  return !counted_all(topic);
}

bool Releaser::wait_drained() {
  return ledger_.wait_drained(
      [this] { return wiring_.receiver() == nullptr || wiring_.receiver()->idle(); });
}

/// How long to release, from the first release on. A count is of the slowest source's releases, so
/// that no source falls silent before the others.
std::int64_t Releaser::run_length_ns(std::int64_t slowest_period_ns) const {
  if (context_.session.releases.duration_us > 0)
    return context_.session.releases.duration_us * 1000;
  const std::uint64_t count = context_.session.releases.activations;
  if (count == 0 || count > static_cast<std::uint64_t>(kForeverNs / slowest_period_ns))
    return kForeverNs;
  return static_cast<std::int64_t>(count) * slowest_period_ns;
}

/// By the program's own function.
Result<std::shared_ptr<const void>> Releaser::make_message(std::size_t source, std::size_t topic,
                                                           std::uint64_t number,
                                                           std::int64_t since_ns) {
  const auto& spec = context_.app.sources[source];
  std::shared_ptr<const void> message;
  try {
    message = spec.make(number, wiring_.publisher(topic));
  } catch (const std::exception& e) {
    return fail(ErrorCode::kUnavailable, std::string("threw: ") + e.what(),
                "the source of topic '" + spec.topic.name + "'");
  }
  account_.made(source, now_ns() - since_ns);
  return message;
}

/// Every source at its period, on one absolute time grid, so that sources of equal period release
/// at the same instants and nothing drifts. Beside what is pushed on the same clock: on its grid,
/// which nobody knows before the first message.
struct Releaser::Periodic {
  struct Source {
    int topic;
    const Grid::Source* grid;
    std::uint64_t sequence = 0;
    std::int64_t due_ns = 0;  ///< of its next release, after `start`; kForeverNs: not known yet
  };
  std::vector<Source> sources = {};
  std::int64_t start = 0;      ///< of the grid
  std::int64_t length_ns = 0;  ///< for how long it releases
  std::int64_t next_ns = 0;    ///< the next release of all, after `start`
  std::vector<Sample> samples = {},
                      fed = {};  ///< of that release; here, so that their memory stays
};

Releaser::Periodic Releaser::begin_periodic() {
  Periodic run;
  std::int64_t slowest_ns = 1;
  phases_.resize(context_.grid.clock_ppm.size());
  starts_.resize(context_.grid.clock_ppm.size());
  for (std::size_t t = 0; t < context_.graph.topics.size(); ++t) {
    if (context_.graph.topics[t].source < 0) continue;
    const Grid::Source& grid =
        context_.grid.sources[static_cast<std::size_t>(context_.graph.topics[t].source)];
    if (tracked(t)) {
      if (tracks() && phases_[grid.clock] == nullptr)
        phases_[grid.clock] = std::make_unique<ClockPhase>(context_.grid.clock_ppm[grid.clock]);
      continue;
    }
    run.sources.push_back({static_cast<int>(t), &grid});
    slowest_ns = std::max(slowest_ns, grid.period_ns());
  }
  pushed_.assign(context_.graph.topics.size(), 0);
  streams_.resize(context_.graph.sources.size());
  // Without a polled source there is no time grid: pushes are counted.
  const bool counts_pushes = run.sources.empty() && context_.session.releases.duration_us == 0;
  pushes_left_ = counts_pushes ? context_.session.releases.activations : 0;
  run.start = part_ ? part_->start_ns : now_ns() + 20'000'000;
  if (part_)
    for (Periodic::Source& s : run.sources) s.sequence = part_->first(*s.grid, s.grid->shift_ns);
  run.length_ns = counts_pushes ? kForeverNs : run_length_ns(slowest_ns);
  return run;
}

/// To who starts early. What a clock that is off releases is told one by one, as what is pushed.
void Releaser::tell_first_releases(const Periodic& run) {
  EarlyStart* early = wiring_.early_start();
  if (early == nullptr) return;
  for (const Periodic::Source& s : run.sources) {
    const ClockStart& clock = starts_[s.grid->clock];
    if (phases_[s.grid->clock] != nullptr) continue;
    if (clock.ppm == 0)
      early->due(s.grid->number, run.start + clock.phase_ns);
    else
      early->released(s.grid->number, 0, run.start + clock.due_ns(s.grid->due_ns(0)));
  }
}

/// `--phases`. Who is pushed or fed has a phase of its own.
Status Releaser::set_clocks_apart(const Periodic& run) {
  if (!context_.session.releases.phases) return {};
  starts_ = clocks_apart(context_.grid, context_.session.releases.seed);
  std::set<std::size_t> told;
  for (const Periodic::Source& s : run.sources) {
    const std::size_t c = s.grid->clock;
    if (c == 0 || phases_[c] != nullptr || !told.insert(c).second) continue;
    notes_.push_back(fmt::format("clock '{}' began {:.3f} ms after the run, {} ppm {} (--phases)",
                                 context_.session.app.clocks[c].name,
                                 static_cast<double>(starts_[c].phase_ns) / 1e6,
                                 std::abs(starts_[c].ppm), starts_[c].ppm < 0 ? "fast" : "slow"));
  }
  if (!told.empty()) return {};
  return fail(ErrorCode::kInvalid,
              "has nothing to do: all clocks but the first are those of what is pushed or fed",
              "--phases", "leave it out: such sources have the phases that they come with");
}

/// When the next release is. True: it may be sooner, with the first message of a clock.
bool Releaser::find_next(Periodic& run) const {
  run.next_ns = run.length_ns;
  bool waits = false;
  for (Periodic::Source& s : run.sources) {
    const auto& phase = phases_[s.grid->clock];
    if (phase == nullptr)
      s.due_ns = starts_[s.grid->clock].due_ns(s.grid->due_ns(s.sequence));
    else
      s.due_ns = phase->base_ns() ? *phase->base_ns() - run.start + s.grid->due_ns(s.sequence)
                                  : kForeverNs;
    waits |= s.due_ns == kForeverNs;
    run.next_ns = std::min(run.next_ns, s.due_ns);
  }
  return waits;
}

/// In lockstep: once the last release has ended, whatever the period: the time grid moves along. False: the run is over.
Result<bool> Releaser::take_turn(Periodic& run, std::int64_t& due_ns) {
  // Before it is said when the others are released, and so that both can be timed.
  if (inlets_->any()) {
    XAUTO_ASSIGN(const bool goes_on, release_pushed(now_ns(), true));
    if (!goes_on) return false;
  }
  XAUTO_TRY(drain());
  const std::int64_t now = now_ns();
  run.start += now - due_ns;
  due_ns = now;
  return true;
}

/// Before their release, so that making them does not count as latency.
Status Releaser::make_messages(Periodic& run, std::int64_t due_ns) {
  run.samples.clear();
  run.fed.clear();
  for (Periodic::Source& s : run.sources) {
    if (s.due_ns > run.next_ns) continue;
    const auto topic = static_cast<std::size_t>(s.topic);
    if (wiring_.interop() != nullptr && wiring_.interop()->feeds(topic)) {
      run.fed.push_back({s.topic, s.sequence++, nullptr, 0});
      continue;
    }
    if (part_ && !context_.plan.heard_here(context_.graph.topics[topic])) {
      run.samples.push_back(
          {.topic = s.topic, .sequence = s.sequence++, .nominal_ns = due_ns, .elsewhere = true});
      continue;
    }
    const auto source = static_cast<std::size_t>(context_.graph.topics[topic].source);
    XAUTO_ASSIGN(auto message, make_message(source, topic, s.sequence, std::max(due_ns, now_ns())));
    XAUTO_ASSIGN(const bool says, marked(source, message.get(), s.sequence));
    const bool is_urgent = says && account_.urgent(source, s.sequence);
    run.samples.push_back({s.topic, s.sequence++, std::move(message),
                           context_.grid.periodic ? due_ns : 0, is_urgent});
  }
  return {};
}

/// False: the run is over.
Result<bool> Releaser::wait_until_due(std::int64_t due_ns) {
  if (inlets_->any() && !context_.session.releases.lockstep) return release_pushed(due_ns);
  if (!context_.session.releases.lockstep) sleep(due_ns);
  return !stop_.load();
}

/// The others have to know when something is released. A source that is asked releases by each host's own clock, also
/// where app.json has it on another one than "main": to a certificate that is a clock with a tolerance, and no drift.
Status Releaser::check_part() const {
  if (!part_) return {};
  for (std::size_t t = 0; t < context_.graph.topics.size(); ++t) {
    if (context_.graph.topics[t].source < 0 || !tracked(t)) continue;
    return fail(ErrorCode::kInvalid,
                "is pushed or fed: no other host would know when it is released",
                "source '" + context_.graph.topics[t].spec.name + "'",
                "with --part all sources are asked for their messages (a function and a period)");
  }
  return {};
}

Status Releaser::release_periodic() {
  XAUTO_TRY(check_part());
  Periodic run = begin_periodic();
  XAUTO_TRY(set_clocks_apart(run));
  tell_first_releases(run);
  end_ns_ = run.length_ns;
  while (!stop_.load()) {
    const bool waits = find_next(run);
    std::int64_t due = run.start + run.next_ns;
    if (waits) {
      XAUTO_ASSIGN(const bool goes_on, release_pushed(due, true));
      if (!goes_on || now_ns() >= run.start + run.length_ns) break;
      if (now_ns() < due) continue;
    }
    if (run.next_ns >= run.length_ns) {
      if (inlets_->any()) XAUTO_TRY(release_pushed(due));
      break;
    }
    if (context_.session.releases.lockstep) {
      XAUTO_ASSIGN(const bool goes_on, take_turn(run, due));
      if (!goes_on) break;
    }
    XAUTO_TRY(make_messages(run, due));
    XAUTO_ASSIGN(const bool goes_on, wait_until_due(due));
    if (!goes_on) break;
    if (!run.fed.empty()) {
      run.start += take_fed(std::move(run.fed), due, run.samples);
      if (stop_.load()) break;
      if (run.samples.empty()) continue;
    }
    release(now_ns(), run.samples);
    run.samples.clear();  // the messages belong to who reads them
  }
  if (stop_.load()) end_ns_ = std::min(end_ns_, now_ns() - run.start);
  return {};
}

/// A message of each source that releases by itself, or is fed. False: the run is over.
Result<bool> Releaser::gather_pushed(std::vector<Sample>& samples, std::uint64_t number,
                                     std::int64_t end_ns) {
  std::vector<int> fed;
  for (std::size_t t = 0; t < context_.graph.topics.size(); ++t) {
    const int source = context_.graph.topics[t].source;
    if (source < 0) continue;
    detail::Inlet* inlet = context_.app.sources[static_cast<std::size_t>(source)].inlet.get();
    if (inlet == nullptr) {
      if (wiring_.interop() != nullptr && wiring_.interop()->feeds(t))
        fed.push_back(static_cast<int>(t));
      continue;
    }
    for (;;) {
      const std::uint32_t seen = inlets_->pushes();
      if (auto waiting = inlet->take()) {
        samples.push_back({static_cast<int>(t), number, std::move(waiting->message), 0});
        samples.back().stamp_ns = waiting->at_ns;
        break;
      }
      if (stop_.load() || now_ns() >= end_ns) return false;
      inlets_->wait(seen, end_ns);
    }
  }
  if (fed.empty()) return true;
  auto taken = wiring_.interop()->take(fed, end_ns, stop_);
  for (std::size_t i = 0; i < fed.size(); ++i) {
    samples.push_back({fed[i], number, std::move(taken.messages[i].message), 0});
    samples.back().stamp_ns = taken.messages[i].origin_ns;
    if (samples.back().message == nullptr) return false;  // it ended before one came
  }
  return true;
}

/// No source has a rate: all release at one instant, once each has a message and the last release has ended. What we
/// ask for messages keeps the program's longest period at least, unless it is in lockstep.
Status Releaser::release_one_at_a_time() {
  const Session& session = context_.session;
  std::vector<std::size_t> polled;  // topics
  for (std::size_t t = 0; t < context_.graph.topics.size(); ++t)
    if (const int source = context_.graph.topics[t].source;
        source >= 0 && context_.app.sources[static_cast<std::size_t>(source)].inlet == nullptr &&
        (wiring_.interop() == nullptr || !wiring_.interop()->feeds(t)))
      polled.push_back(t);
  const std::int64_t period_ns =
      context_.grid.sources.empty() ? 0 : context_.grid.sources.front().period_ns();
  const std::int64_t start = now_ns() + 20'000'000;
  const std::int64_t end =
      session.releases.duration_us > 0 ? start + session.releases.duration_us * 1000 : kForeverNs;
  std::int64_t due = start, longest_wait_ns = 0;
  std::uint64_t waited = 0, number = 0;
  std::vector<Sample> samples;
  for (; !stop_.load() && (session.releases.activations == 0 || session.releases.duration_us > 0 ||
                           number < session.releases.activations);
       ++number) {
    if (session.releases.lockstep && !wait_drained()) break;  // the run tells what does not end
    samples.clear();
    // Messages are made before their release, so that making them does not count as latency.
    for (const std::size_t t : polled) {
      const auto source = static_cast<std::size_t>(context_.graph.topics[t].source);
      XAUTO_ASSIGN(auto message, make_message(source, t, number, std::max(due, now_ns())));
      samples.push_back({static_cast<int>(t), number, std::move(message), 0});
    }
    if (!session.releases.lockstep && !polled.empty()) sleep(std::min(due, end));
    XAUTO_ASSIGN(const bool all, gather_pushed(samples, number, end));
    if (!all || stop_.load() || std::max(due, now_ns()) >= end) break;
    std::int64_t there_ns = polled.empty() ? 0 : due;
    for (const Sample& sample : samples) there_ns = std::max(there_ns, sample.stamp_ns);
    const bool free = !session.releases.lockstep && ledger_.all_ended();
    if (!wait_drained()) break;
    const std::int64_t now = now_ns();
    if (!session.releases.lockstep && !free) {
      ++waited;
      longest_wait_ns = std::max(longest_wait_ns, now - there_ns);
    }
    for (Sample& sample : samples) {
      sample.nominal_ns = now;
      sample.stamp_ns = 0;
    }
    release(now, samples);
    due = session.releases.lockstep ? now : std::max(due + period_ns, now);
  }
  if (waited > 0)
    notes_.push_back(
        fmt::format("{} of {} releases waited for the end of the one before, up to {:.2f} ms: "
                    "app.json states no "
                    "rates, so none meets another; a release's time begins when it is let in",
                    waited, number, static_cast<double>(longest_wait_ns) * 1e-6));
  return {};
}

/// Messages that programs outside feed us. In an app of one rate a release waits for its message,
/// for up to a period; without one it is lost, and told so downstream. Otherwise there is one or
/// there is none. Returns by how much the time grid moves.
std::int64_t Releaser::take_fed(std::vector<Sample> fed, std::int64_t due_ns,
                                std::vector<Sample>& samples) {
  const auto source = static_cast<std::size_t>(
      context_.graph.topics[static_cast<std::size_t>(fed.front().topic)].source);
  const std::int64_t period_ns = context_.grid.sources[source].period_ns();
  std::int64_t until = now_ns();
  if (context_.graph.single_rate)  // nothing to do before the first
    until = fed.front().sequence == 0 ? INT64_MAX : until + period_ns;
  std::vector<int> topics;
  for (const Sample& sample : fed) topics.push_back(sample.topic);
  auto taken = wiring_.interop()->take(topics, until, stop_);
  const bool all =
      std::ranges::all_of(taken.messages, [](const auto& one) { return one.message != nullptr; });
  for (std::size_t i = 0; i < fed.size(); ++i) {
    fed[i].message = std::move(taken.messages[i].message);  // null: a tombstone, for whoever counts
    fed[i].stamp_ns = taken.messages[i].origin_ns;
    samples.push_back(std::move(fed[i]));
  }
  // After one that waited in vain the next waits at once: else what came a little late would lie there until a
  // period later.
  return context_.graph.single_rate && all ? fed_grid_.move_ns(due_ns, period_ns, taken.came_ns)
                                           : 0;
}

/// When the next ones come of a clock that is not ours.
void Releaser::tell_early_start(const Sample& sample) {
  EarlyStart* early = wiring_.early_start();
  const Grid::Source& source = context_.grid.sources[static_cast<std::size_t>(
      context_.graph.topics[static_cast<std::size_t>(sample.topic)].source)];
  if (early != nullptr && (phases_[source.clock] != nullptr || starts_[source.clock].ppm != 0))
    early->released(source.number, sample.sequence, sample.nominal_ns);
}

void Releaser::report(RunReport& into) const {
  if (tables_) tables_->report(into);
  account_.report(phases_, into.account);
}

/// The earliest nominal release of the activations that `samples` are for.
std::int64_t Releaser::component_release_ns(std::int64_t now_ns,
                                            std::span<const Sample> samples) const {
  std::int64_t earliest_ns = INT64_MAX;
  for (const Sample& sample : samples) {
    const auto source = static_cast<std::size_t>(
        context_.graph.topics[static_cast<std::size_t>(sample.topic)].source);
    const std::int64_t nominal_ns = sample.nominal_ns > 0 ? sample.nominal_ns : now_ns;
    earliest_ns = std::min(earliest_ns, nominal_ns - context_.grid.sources[source].shift_ns);
  }
  return earliest_ns;
}

void Releaser::release(std::int64_t now_ns, const std::vector<Sample>& samples) {
  const std::uint64_t sequence = samples.front().sequence;
  // What waited was not released before.
  if (tables_ != nullptr) tables_->at_release(component_release_ns(now_ns, samples));
  const auto left_out = [&](const Sample& sample) {
    return tables_ != nullptr &&
           tables_->leaves_out(component_release_ns(now_ns, std::span(&sample, 1)));
  };
  const auto origin_of = [&](const Sample& sample) {
    if (sample.nominal_ns > 0) return sample.nominal_ns;
    return sample.stamp_ns > 0 ? sample.stamp_ns : now_ns;
  };
  for (const Sample& sample : samples)
    if (sample.nominal_ns > 0 && !sample.elsewhere) {
      account_.released(static_cast<std::size_t>(
                            context_.graph.topics[static_cast<std::size_t>(sample.topic)].source),
                        now_ns - sample.nominal_ns);
      tell_early_start(sample);
    }
  std::int64_t oldest_ns = INT64_MAX;
  for (const Sample& sample : samples) oldest_ns = std::min(oldest_ns, origin_of(sample));
  ledger_.open(sequence, oldest_ns);
  // Nothing can come out of what has no message, or is left out.
  for (const Sample& sample : samples)
    if ((sample.message != nullptr || sample.elsewhere) && !left_out(sample))
      ledger_.released(static_cast<std::size_t>(
                           context_.graph.topics[static_cast<std::size_t>(sample.topic)].source),
                       sample.sequence, origin_of(sample));
  if (context_.trace != nullptr) {
    // One release in an app of one rate, several otherwise.
    const bool whole = context_.graph.single_rate && !context_.grid.periodic;
    for (std::size_t i = 0; i < (whole ? 1 : samples.size()); ++i) {
      const auto& topic = context_.graph.topics[static_cast<std::size_t>(samples[i].topic)];
      context_.trace->write_at(
          whole ? oldest_ns : origin_of(samples[i]), XAUTO_EV_PUBLISH, samples[i].sequence,
          XAUTO_EV_NONE, XAUTO_EV_NONE, XAUTO_EV_NONE,
          whole ? 0
                : XAUTO_TAKE_SOURCE | (samples[i].urgent ? XAUTO_RELEASE_URGENT : 0) |
                      context_.grid.sources[static_cast<std::size_t>(topic.source)].number);
    }
  }
  if (recorder_)
    for (const Sample& sample : samples)
      if (!sample.elsewhere)
        recorder_->record(static_cast<std::size_t>(sample.topic), now_ns, sample.sequence,
                          sample.message.get());
  for (const Sample& sample : samples) {
    if (sample.elsewhere) continue;
    const int topic = sample.topic;
    const std::int64_t origin_ns = origin_of(sample);
    if (left_out(sample)) {  // nobody waits for it, and nothing was lost
      wiring_.channel(static_cast<std::size_t>(topic))
          .publish({nullptr, detail::kSkippedNs, sample.sequence});
      continue;
    }
    detail::Envelope envelope{sample.message, origin_ns, sample.sequence};
    envelope.urgent = sample.urgent;
    if (context_.graph.tells_origins) {
      auto origins = std::make_shared<detail::Origins>();
      origins->fill(0);
      const auto source =
          static_cast<std::size_t>(context_.graph.topics[static_cast<std::size_t>(topic)].source);
      if (source < origins->size()) (*origins)[source] = origin_ns;
      envelope.origins = std::move(origins);
    }
    wiring_.channel(static_cast<std::size_t>(topic)).publish(envelope);
  }
}

/// The topic of the source with the longest period.
int Releaser::slowest_source() const {
  int slowest = -1;
  Period longest;
  for (std::size_t t = 0; t < context_.graph.topics.size(); ++t) {
    if (context_.graph.topics[t].source < 0) continue;
    const auto period =
        context_.app.sources[static_cast<std::size_t>(context_.graph.topics[t].source)].period;
    if (period > longest) {
      longest = period;
      slowest = static_cast<int>(t);
    }
  }
  return slowest;
}

constexpr int kMaxGapsTold = 5;

/// Between two releases of a recording. A long one is told before it is waited for.
std::int64_t Releaser::distance_ns(std::int64_t from_ns, std::int64_t to_ns) {
  const Session& session = context_.session;
  const auto recorded_ns =
      static_cast<std::int64_t>(static_cast<double>(to_ns - from_ns) / session.releases.input_rate);
  const std::int64_t distance_ns =
      session.releases.input_max_gap_us > 0
          ? std::min(recorded_ns, session.releases.input_max_gap_us * 1000)
          : recorded_ns;
  if (to_ns - from_ns <= record::kGapNs || session.releases.lockstep) return distance_ns;
  std::string line = "the recording has " + record::gap_text(from_ns, to_ns) + ": ";
  line +=
      distance_ns < recorded_ns
          ? fmt::format("{:.3f} s of it are waited for", static_cast<double>(distance_ns) * 1e-9)
          : fmt::format("the next message comes in {:.0f} s; --max-gap 1s or --rate shortens that",
                        static_cast<double>(distance_ns) * 1e-9);
  log::warn("{}", line);
  if (++gaps_ <= kMaxGapsTold) notes_.push_back(std::move(line));
  return distance_ns;
}

/// Releases a recording's messages: message k of each recorded source topic is release k. In
/// lockstep, or at the recorded distances in time (as `input_rate` and `input_max_gap_us` have
/// them, or `period_us`).
Status Releaser::release_recorded() {
  XAUTO_ASSIGN(auto recording, record::Recording::open(context_.session.releases.input));
  std::vector<int> topic_of(recording.topics().size(), -1);
  std::set<int> missing;
  for (std::size_t t = 0; t < context_.graph.topics.size(); ++t)
    if (context_.graph.topics[t].source >= 0) missing.insert(static_cast<int>(t));
  for (std::size_t r = 0; r < recording.topics().size(); ++r)
    for (const int t : std::set<int>(missing))
      if (record::is_app_topic(recording.topics()[r],
                               context_.graph.topics[static_cast<std::size_t>(t)].spec.name)) {
        topic_of[r] = t;
        missing.erase(t);
      }
  if (!recording.note().empty()) notes_.push_back(recording.note());
  const auto topic_name = [&](int t) {
    return context_.graph.topics[static_cast<std::size_t>(t)].spec.name;
  };
  if (!missing.empty())
    return fail(
        ErrorCode::kInvalid, "has no messages for topic '" + topic_name(*missing.begin()) + "'",
        context_.session.releases.input, "record the app's own sources with `xauto run --record`");

  std::vector<std::uint64_t> sequence(context_.graph.topics.size(), 0);
  // Messages of one instant are one release; so are the k-th messages of all topics in a
  // single-rate app.
  std::vector<Sample> batch;
  std::size_t num_topics = 0;
  for (const int t : topic_of) num_topics += t >= 0 ? 1 : 0;
  std::int64_t last_stamp = -1, start = 0, at_ns = 0;
  std::uint64_t releases = 0, counted = 0;  // of all sources; of the slowest
  const int slowest = slowest_source();
  while (!stop_.load() && (context_.session.releases.activations == 0 ||
                           counted < context_.session.releases.activations)) {
    XAUTO_ASSIGN(auto message, recording.next());
    if (!message) break;
    const int t = topic_of[message->topic];
    if (t < 0) continue;
    const detail::TopicSpec& spec = context_.graph.topics[static_cast<std::size_t>(t)].spec;
    if (spec.decode == nullptr)
      return fail(ErrorCode::kInvalid, "messages of type " + spec.type_name + " cannot be decoded",
                  "topic '" + spec.name + "'", "specialise xauto::Codec for it");
    std::uint64_t& number = sequence[static_cast<std::size_t>(t)];
    XAUTO_ASSIGN(const auto data,
                 record::enclosed(recording.topics()[message->topic], message->data));
    try {
      batch.push_back({t, number, spec.decode(data), 0});
    } catch (const std::exception& e) {
      return fail(ErrorCode::kInvalid, "message " + std::to_string(number) + ": " + e.what(),
                  context_.session.releases.input + ": topic '" + spec.name + "'");
    }
    ++number;
    if (context_.graph.single_rate && batch.size() < num_topics) continue;
    if (last_stamp < 0) {
      last_stamp = message->timestamp_ns;
      start = now_ns() + 20'000'000;
    }
    if (context_.session.releases.period_us > 0)
      at_ns = static_cast<std::int64_t>(releases) * context_.session.releases.period_us * 1000;
    else
      at_ns += distance_ns(last_stamp, message->timestamp_ns);
    last_stamp = message->timestamp_ns;
    if (context_.session.releases.duration_us > 0 &&
        at_ns >= context_.session.releases.duration_us * 1000)
      break;
    if (!context_.session.releases.lockstep) sleep(start + at_ns);
    XAUTO_TRY(drain());
    if (stop_.load()) break;
    release(now_ns(), batch);
    batch.clear();
    ++releases;
    if (context_.graph.single_rate || t == slowest) ++counted;
  }
  return {};
}

}  // namespace xauto::runtime
