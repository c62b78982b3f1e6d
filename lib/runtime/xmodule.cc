// SPDX-License-Identifier: Apache-2.0
#include "runtime/xmodule.h"

#include <algorithm>
#include <utility>

#include <uapi/xauto/event.h>

#include "base/log.h"

namespace xauto::runtime {
namespace {

/// Why the releases up to that of a tombstone are lost here.
std::uint32_t reason_of(const detail::Envelope& tombstone) {
  return tombstone.origin_ns == detail::kOffNs       ? XAUTO_DROP_OFF
         : tombstone.origin_ns == detail::kSkippedNs ? XAUTO_DROP_SKIPPED
                                                     : XAUTO_DROP_UPSTREAM;
}

/// For who hears the tombstone.
std::int64_t origin_of(std::uint32_t reason) {
  return reason == XAUTO_DROP_OFF       ? detail::kOffNs
         : reason == XAUTO_DROP_SKIPPED ? detail::kSkippedNs
                                        : 0;
}

}  // namespace

ModuleRuntime::ModuleRuntime(const Graph& graph, int index, ModuleHost& host,
                             std::vector<const transport::Channel*> outputs,
                             std::vector<detail::MessageMemory*> memories, int in_flight)
    : newest_from_(graph.modules[static_cast<std::size_t>(index)].spec->inputs.size()),
      index_(index),
      numbered_(graph.modules[static_cast<std::size_t>(index)].numbered),
      tells_origins_(graph.tells_origins),
      looks_first_(tells_origins_ ||
                   !graph.modules[static_cast<std::size_t>(index)].samples.empty()),
      host_(host),
      queues_(newest_from_),
      module_(graph.modules[static_cast<std::size_t>(index)]),
      outputs_(std::move(outputs)),
      memories_(std::move(memories)),
      topics_(module_.spec->inputs),
      newest_(module_.spec->samples.size()) {
  for (const detail::SampleSpec& sample : module_.spec->samples) topics_.push_back(sample.topic);
  for (int i = 0; i < in_flight; ++i)
    activations_.push_back(
        std::make_unique<Activation>(i, module_.spec->make_state(), &topics_, newest_from_));
  if (in_flight == 1) only_ = activations_.front().get();
  memories_.resize(module_.spec->outputs.size());
}

void ModuleRuntime::receive(int input, const detail::Envelope& envelope) {
  if (static_cast<std::size_t>(input) >= newest_from_) {
    if (envelope.message == nullptr) return;  // what was lost replaces nothing
    const Guard lock(mutex_);
    newest_[static_cast<std::size_t>(input) - newest_from_] = envelope;
    return;
  }
  std::vector<Lost> lost;
  Started started;
  bool any_over;
  {
    const Guard lock(mutex_);
    InputQueue& queue = queues_[static_cast<std::size_t>(input)];
    if (numbered_ && envelope.sequence < next_) return;  // of a release that is already lost
    if (!arrives_alone(queue, envelope)) arrive(queue, envelope, lost);
    fire(lost, started);
    any_over = over();
  }
  if (any_over) {
    const Guard order(order_);
    collect();
    tell_settled(lost, started);
  }
  tell(lost);
  activate(started);
}

/// The common case, which loses nothing: the next message, and none before it waits. False: it is not
/// that one. Called with the mutex held.
bool ModuleRuntime::arrives_alone(InputQueue& queue, const detail::Envelope& envelope) {
  const bool next = envelope.sequence == queue.expected && envelope.message != nullptr;
  if (!numbered_ || !next || !queue.waiting.empty() || hung_ > 0 ||
      overload_.kind == Overload::Kind::kSkip)
    return false;
  ++queue.expected;
  queue.waiting.push_back(envelope);
  return true;
}

/// Called with the mutex held.
void ModuleRuntime::arrive(InputQueue& queue, const detail::Envelope& envelope,
                           std::vector<Lost>& lost) {
  if (hung_ == activations_.size()) return lose_while_hung(queue, envelope, lost);
  // Messages come in order: what lies between was lost on the way (a full queue between processes).
  // What was settled meanwhile is not missing.
  const std::uint64_t expected =
      std::max(std::exchange(queue.expected, envelope.sequence + 1), numbered_ ? next_ : 0);
  const bool gap = envelope.sequence > expected && envelope.message != nullptr;
  if (match_ns_ >= 0 && !numbered_) {
    constexpr std::size_t kDepth = 16;  // unless it says queue:N
    const std::size_t depth = overload_.kind == Overload::Kind::kQueue ? overload_.depth : kDepth;
    if (envelope.message != nullptr) queue.waiting.push_back(envelope);
    while (queue.waiting.size() > depth) {
      const std::uint64_t oldest = queue.waiting.front().sequence;
      lost.push_back({oldest, oldest, XAUTO_DROP_OVERRUN});
      queue.waiting.pop_front();
    }
    return;
  }
  if (overload_.kind == Overload::Kind::kQueue) {
    // Losses wait in the queue, too: what came before them is not lost.
    if (numbered_ && gap) queue.waiting.push_back({nullptr, 0, envelope.sequence - 1});
    if (numbered_ || envelope.message != nullptr) queue.waiting.push_back(envelope);
    while (queue.waiting.size() > overload_.depth) {
      const std::uint64_t oldest = queue.waiting.front().sequence;
      if (numbered_) {
        settle(oldest + 1, XAUTO_DROP_OVERRUN, lost);
      } else {
        lost.push_back({oldest, oldest, XAUTO_DROP_OVERRUN});
        queue.waiting.pop_front();
      }
    }
    return;
  }
  // What an end lets come (the next release in lockstep, say) is there before that end is told to all: it waits for
  // the activation, which is free then.
  const bool skip = skips_ && room() == nullptr && !ending_ && envelope.message != nullptr;
  const std::uint32_t replaced = skips_ && ending_ ? XAUTO_DROP_SKIPPED : XAUTO_DROP_OVERRUN;
  if (numbered_) {
    if (gap) settle(envelope.sequence, XAUTO_DROP_OVERRUN, lost);
    if (envelope.message == nullptr)
      settle(envelope.sequence + 1, reason_of(envelope), lost);
    else if (skip)
      settle(envelope.sequence + 1, XAUTO_DROP_SKIPPED, lost);
    else if (!queue.waiting.empty())
      settle(queue.waiting.front().sequence + 1, replaced, lost);
  } else if (skip) {
    lost.push_back({envelope.sequence, envelope.sequence, XAUTO_DROP_SKIPPED});
  } else if (!queue.waiting.empty()) {
    const std::uint64_t old = queue.waiting.front().sequence;
    lost.push_back({old, old, replaced});
  }
  if (envelope.message == nullptr || skip) return;
  queue.waiting.clear();
  queue.waiting.push_back(envelope);
}

/// What comes while exec does not return. Called with the mutex held.
void ModuleRuntime::lose_while_hung(InputQueue& queue, const detail::Envelope& envelope,
                                    std::vector<Lost>& lost) {
  queue.expected = std::max(queue.expected, envelope.sequence + 1);
  if (numbered_)
    settle(envelope.sequence + 1, XAUTO_DROP_HUNG, lost);
  else if (envelope.message != nullptr)
    lost.push_back({envelope.sequence, envelope.sequence, XAUTO_DROP_HUNG});
}

/// Losses whose turn it is. Called with the mutex held.
void ModuleRuntime::resolve(std::vector<Lost>& lost) {
  for (bool again = numbered_; again;) {
    again = false;
    for (const InputQueue& queue : queues_)
      if (!queue.waiting.empty() && queue.waiting.front().message == nullptr) {
        const detail::Envelope& front = queue.waiting.front();
        settle(front.sequence + 1, reason_of(front), lost);
        again = true;
      }
  }
}

/// Every release below `below` that is not settled yet is lost. Called with the mutex held.
void ModuleRuntime::settle(std::uint64_t below, std::uint32_t reason, std::vector<Lost>& lost) {
  if (below <= next_) return;
  lost.push_back({next_, below - 1, reason});
  next_ = below;
  for (InputQueue& queue : queues_)
    while (!queue.waiting.empty() && queue.waiting.front().sequence < next_)
      queue.waiting.pop_front();
}

/// Whether the oldest messages belong together; those that can have no partner are lost: every
/// queue is in the order of its origins, so what is older than all that another queue can still
/// bring, less the tolerance, waits in vain. Called with the mutex held.
bool ModuleRuntime::matched(std::vector<Lost>& lost) {
  const auto by_origin = [](const InputQueue& a, const InputQueue& b) {
    return a.waiting.front().origin_ns < b.waiting.front().origin_ns;
  };
  while (std::none_of(queues_.begin(), queues_.end(),
                      [](const InputQueue& s) { return s.waiting.empty(); })) {
    const auto [oldest, newest] = std::minmax_element(queues_.begin(), queues_.end(), by_origin);
    if (newest->waiting.front().origin_ns - oldest->waiting.front().origin_ns <= match_ns_)
      return true;
    const std::uint64_t sequence = oldest->waiting.front().sequence;
    lost.push_back({sequence, sequence, XAUTO_DROP_OVERRUN});
    oldest->waiting.pop_front();
  }
  return false;
}

Activation* ModuleRuntime::room_of_several() {
  for (const auto& activation : activations_)
    if (activation->stage_ == Activation::Stage::kFree) return activation.get();
  return nullptr;
}

void ModuleRuntime::Started::add(Activation& activation) {
  activation.next_ = nullptr;
  (last == nullptr ? first : last->next_) = &activation;
  last = &activation;
}

/// Numbered: what was lost gets its turn. Otherwise it is told at once. Called with the mutex held.
void ModuleRuntime::take_turns(std::vector<Lost>& lost) {
  for (const Lost& range : lost) {
    Turn* newest = turns_.empty() ? nullptr : &turns_[turns_.size() - 1];
    if (newest != nullptr && newest->activation == nullptr && newest->lost.reason == range.reason &&
        newest->lost.last + 1 == range.first)
      newest->lost.last = range.last;
    else
      turns_.push_back({nullptr, range});
  }
  lost.clear();
}

/// Fires as often as there are fresh inputs, and room. Called with the mutex held.
void ModuleRuntime::fire_all(std::vector<Lost>& lost, Started& started) {
  line_up(lost);
  for (Activation* free = room(); free != nullptr && fresh(lost); free = room()) {
    if (leaves_out(lost)) continue;
    take(*free, lost);
    line_up(lost);
    turns_.push_back({free, {}});
    started.add(*free);
  }
  line_up(lost);
}

std::size_t ModuleRuntime::waiting() {
  const Guard lock(mutex_);
  std::size_t most = 0;
  for (const InputQueue& queue : queues_) most = std::max(most, queue.waiting.size());
  return most;
}

/// Every input has a message, and they belong together. Called with the mutex held.
bool ModuleRuntime::fresh(std::vector<Lost>& lost) {
  if (overload_.kind == Overload::Kind::kQueue) resolve(lost);  // only there do losses wait
  if (queues_[empty_].waiting.empty()) return false;
  if (match_ns_ >= 0 && !numbered_ && !matched(lost)) return false;
  for (empty_ = 0; empty_ < queues_.size() && !queues_[empty_].waiting.empty();) ++empty_;
  if (empty_ < queues_.size()) return false;
  empty_ = 0;
  return true;
}

/// Whether the fresh messages are of a release in whose table the module is off; then they are gone.
/// Called with the mutex held.
bool ModuleRuntime::leaves_out(std::vector<Lost>& lost) {
  if (off_.empty()) return false;
  std::int64_t released_ns = INT64_MAX;
  std::uint64_t sequence = 0;
  for (const InputQueue& queue : queues_) {
    const detail::Envelope& message = queue.waiting.front();
    if (message.origin_ns - queue.shift_ns >= released_ns) continue;
    released_ns = message.origin_ns - queue.shift_ns;
    sequence = message.sequence;
  }
  if (off_[table_of(released_ns)] == 0) return false;
  if (numbered_) {
    settle(sequence, XAUTO_DROP_OVERRUN, lost);
    settle(sequence + 1, XAUTO_DROP_OFF, lost);
  } else {
    for (InputQueue& queue : queues_) queue.waiting.pop_front();
    lost.push_back({sequence, sequence, XAUTO_DROP_OFF});
  }
  line_up(lost);
  return true;
}

/// Moves the fresh messages into the activation's input. Called with the mutex held.
void ModuleRuntime::take(Activation& activation, std::vector<Lost>& lost) {
  std::int64_t released_ns = INT64_MAX;
  std::uint64_t sequence = 0;
  std::vector<detail::Envelope>& messages = InputAccess::messages(activation.input_);
  activation.urgent_ = activation.marks_ = false;
  for (std::size_t i = 0; i < queues_.size(); ++i) {
    detail::Envelope& message = messages[i];
    queues_[i].waiting.take_front(message);
    activation.urgent_ |= message.urgent;
    if (message.origin_ns - queues_[i].shift_ns >= released_ns) continue;
    released_ns = message.origin_ns - queues_[i].shift_ns;
    sequence = message.sequence;
  }
  InputAccess::stamp(activation.input_, released_ns, sequence);
  if (numbered_) {
    settle(sequence, XAUTO_DROP_OVERRUN, lost);
    next_ = std::max(next_, sequence + 1);
  }
  if (tables_ != nullptr) activation.table_ = table_of(released_ns);
  activation.stage_ = Activation::Stage::kRuns;
  activation.number_ = fired_++;
  activation.position_ = 0;
}

void ModuleRuntime::activate_all(Started started) {
  for (Activation* activation = started.first; activation != nullptr;) {
    Activation* next = activation->next_;  // read first: it may be at its end soon
    host_.activate(index_, *activation);
    activation = next;
  }
}

void ModuleRuntime::read_parameters(ParameterReader reader) {
  parameters_ = std::move(reader);
  if (!parameters_.now().empty()) looks_first_ = true;
  for (const auto& activation : activations_)
    InputAccess::parameters(activation->input_) = parameters_.now();
}

/// What the activation sees until its end. Texts have room, so nothing is allocated.
void ModuleRuntime::take_parameters(Activation& activation) {
  parameters_.look();
  if (activation.parameters_ == parameters_.version()) return;
  activation.parameters_ = parameters_.version();
  std::vector<detail::ParameterNow>& seen = InputAccess::parameters(activation.input_);
  for (std::size_t i = 0; i < seen.size(); ++i) {
    seen[i].bits = parameters_.now()[i].bits;
    seen[i].text.assign(parameters_.now()[i].text);
  }
}

void ModuleRuntime::begin(Activation& activation, std::int64_t now_ns) {
  InputAccess::begin(activation.input_, now_ns);
  take_parameters(activation);
  if (samples()) {
    const Guard lock(mutex_);
    std::vector<detail::Envelope>& messages = InputAccess::messages(activation.input_);
    for (std::size_t i = 0; i < newest_.size(); ++i) {
      const std::int64_t limit_ns = module_.spec->samples[i].max_age_ns;
      const bool fresh = limit_ns == 0 || now_ns - newest_[i].origin_ns <= limit_ns;
      messages[newest_from_ + i] = fresh ? newest_[i] : detail::Envelope{};
    }
  }
  if (tells_origins_) gather_origins(activation);
  if (samples())
    host_.sampled(index_,
                  std::span(InputAccess::messages(activation.input_)).subspan(newest_from_));
}

/// By source, the oldest of what this activation is made from.
void ModuleRuntime::gather_origins(Activation& activation) {
  auto origins = std::make_shared<detail::Origins>();
  origins->fill(0);
  const std::vector<detail::Envelope>& messages = InputAccess::messages(activation.input_);
  for (std::size_t m = 0; m < messages.size(); ++m) {
    if (messages[m].origins == nullptr) continue;
    const detail::Origins& of = *messages[m].origins;
    const std::uint32_t onward = m < newest_from_ ? ~0u : module_.sample_origins[m - newest_from_];
    for (std::size_t i = 0; i < origins->size(); ++i)
      if (of[i] != 0 && (onward >> i & 1u) != 0 && ((*origins)[i] == 0 || of[i] < (*origins)[i]))
        (*origins)[i] = of[i];
  }
  activation.origins_ = std::move(origins);
}

// ---- several in flight -------------------------------------------------------------------------

/// An older one is not through with the next XNode. Called with the mutex held.
bool ModuleRuntime::held(const Activation& activation) {
  return std::any_of(activations_.begin(), activations_.end(), [&](const auto& other) {
    return other->stage_ == Activation::Stage::kRuns && other->number_ < activation.number_ &&
           other->position_ <= activation.position_;
  });
}

bool ModuleRuntime::may_enter(Activation& activation) {
  const Guard lock(mutex_);
  activation.parked_ = held(activation);
  return !activation.parked_;
}

/// Those that wait no longer. Called with the mutex held.
void ModuleRuntime::unpark(Started& free) {
  for (const auto& activation : activations_) {
    if (!activation->parked_ || held(*activation)) continue;
    activation->parked_ = false;
    free.add(*activation);
  }
}

void ModuleRuntime::let_others_in(Activation& activation) {
  Started free;
  {
    const Guard lock(mutex_);
    ++activation.position_;
    unpark(free);
  }
  proceed(free);
}

void ModuleRuntime::proceed(Started parked) {
  for (Activation* activation = parked.first; activation != nullptr;) {
    Activation* next = activation->next_;
    host_.proceed(index_, *activation, activation->position_);
    activation = next;
  }
}

// ---- the end -----------------------------------------------------------------------------------

void ModuleRuntime::finish(Activation& activation, bool succeeded) {
  if (watched_) {
    using Fate = Activation::Fate;
    Fate open = Fate::kOpen;
    if (!activation.fate_.compare_exchange_strong(open, Fate::kEnding))
      return give_back(activation);
  }
  if (succeeded) {
    try {
      for (std::size_t i = 0; i < module_.spec->outputs.size(); ++i)
        activation.taken_.push_back(
            module_.spec->outputs[i].take(activation.state(), memories_[i]));
      activation.marks_ = marks_line_ != nullptr && module_.spec->urgent_if(activation.state());
    } catch (...) {  // a user's copy constructor: as if the last exec had failed
      succeeded = false;
    }
  }
  std::vector<Lost> lost;
  Started free, started;
  {
    const Guard order(order_);
    if (only_ != nullptr) {
      settle_only(activation, succeeded, lost, started);
    } else {
      {
        const Guard lock(mutex_);
        activation.stage_ = succeeded ? Activation::Stage::kSucceeded : Activation::Stage::kFailed;
        unpark(free);
        collect_locked();
      }
      proceed(free);
      tell_settled(lost, started);
    }
  }
  tell(lost);
  activate(started);
}

/// One in flight: it is the oldest of all that is not settled, and nobody waits behind it inside.
void ModuleRuntime::settle_only(Activation& activation, bool succeeded, std::vector<Lost>& lost,
                                Started& started) {
  Skipped skipped;
  if (skips_) {
    const Guard lock(mutex_);
    ending_ = true;
  }
  tell(activation, succeeded, skipped);
  tell_skipped(skipped);
  {
    const Guard lock(mutex_);
    turns_.pop_front();
    ending_ = false;
    empty(activation);
    fire(lost, started);
    collect_locked();
  }
  tell_settled(lost, started);
}

void ModuleRuntime::missed(std::uint64_t sequence, std::int64_t late_ns) const {
  if (!module_.spec->on_miss) return;
  try {
    module_.spec->on_miss(sequence, std::chrono::nanoseconds(late_ns));
  } catch (const std::exception& e) {
    log::warn("on_miss of XModule '{}' threw: {}", module_.name, e.what());
  } catch (...) {
    log::warn("on_miss of XModule '{}' threw", module_.name);
  }
}

bool ModuleRuntime::abandon(std::uint64_t sequence) {
  using Fate = Activation::Fate;
  using Stage = Activation::Stage;
  std::vector<Lost> lost;
  Started free, started;
  {
    const Guard order(order_);
    {
      const Guard lock(mutex_);
      const auto found =
          std::find_if(activations_.begin(), activations_.end(), [&](const auto& activation) {
            return activation->stage_ == Stage::kRuns && activation->sequence() == sequence;
          });
      Fate open = Fate::kOpen;
      if (found == activations_.end() ||
          !(*found)->fate_.compare_exchange_strong(open, Fate::kAbandoned))
        return false;
      (*found)->stage_ = Stage::kHung;
      ++hung_;
      for (std::size_t i = 0; i < turns_.size(); ++i)
        if (turns_[i].activation == found->get())
          turns_[i] = {nullptr, {sequence, sequence, XAUTO_DROP_HUNG}};
      unpark(free);
      if (hung_ == activations_.size())
        for (InputQueue& queue : queues_)
          for (auto waiting = std::exchange(queue.waiting, {}); !waiting.empty();
               waiting.pop_front())
            lose_while_hung(queue, waiting.front(), lost);
      line_up(lost);
      collect_locked();
    }
    proceed(free);
    tell_settled(lost, started);
  }
  tell(lost);
  host_.left(index_);
  activate(started);
  return true;
}

/// It returned after all; what it did is lost, and known to be.
void ModuleRuntime::give_back(Activation& activation) {
  std::vector<Lost> lost;
  Started started;
  {
    const Guard order(order_);
    {
      const Guard lock(mutex_);
      empty(activation);
      --hung_;
      fire(lost, started);
      collect_locked();
    }
    tell_settled(lost, started);
  }
  tell(lost);
  activate(started);
}

/// Room for the next one. Called with the mutex held.
void ModuleRuntime::empty(Activation& activation) {
  for (detail::Envelope& message : InputAccess::messages(activation.input_)) {
    message.message.reset();
    message.origins.reset();
  }
  activation.stage_ = Activation::Stage::kFree;
  if (watched_) activation.fate_.store(Activation::Fate::kOpen);
}

void ModuleRuntime::collect() {
  const Guard lock(mutex_);
  collect_locked();
}

void ModuleRuntime::tell_collected(std::vector<Lost>& lost, Started& started) {
  Skipped skipped;
  for (const Turn& turn : settled_) tell(turn, skipped);
  tell_skipped(skipped);
  const Guard lock(mutex_);
  for (const Turn& turn : settled_)
    if (turn.activation != nullptr) empty(*turn.activation);
  settled_.clear();
  ending_ = false;
  fire(lost, started);
  collect_locked();
}

void ModuleRuntime::tell(const Turn& turn, Skipped& skipped) {
  if (turn.activation == nullptr) {
    tell_all({turn.lost});
    skip_below(turn.lost.last + 1, origin_of(turn.lost.reason), skipped);
    return;
  }
  tell(*turn.activation, turn.activation->stage_ == Activation::Stage::kSucceeded, skipped);
}

void ModuleRuntime::tell(Activation& activation, bool succeeded, Skipped& skipped) {
  const std::uint64_t sequence = activation.sequence();
  if (succeeded) {
    tell_skipped(skipped);
    const bool urgent = activation.urgent_ || (activation.marks_ && may_mark(sequence));
    host_.done(index_, activation);
    for (std::size_t i = 0; i < activation.taken_.size(); ++i)
      outputs_[i]->publish({std::move(activation.taken_[i]), activation.origin_ns(), sequence,
                            activation.origins_, urgent});
  } else {
    tell_all({{sequence, sequence, XAUTO_DROP_FAILED}});
    skip_below(sequence + 1, 0, skipped);
  }
  activation.taken_.clear();
  host_.left(index_);
}

/// Two are so many releases apart, as the certificate has it: what is nearer is an ordinary one.
bool ModuleRuntime::may_mark(std::uint64_t sequence) {
  if (marks_apart_ == 0) {
    marks_line_->urgent_unheard.fetch_add(1, std::memory_order_relaxed);
    return false;
  }
  if (last_marked_ && sequence - *last_marked_ < marks_apart_) {
    marks_line_->urgent_too_soon.fetch_add(1, std::memory_order_relaxed);
    return false;
  }
  last_marked_ = sequence;
  return true;
}

/// No job of what was lost will start any more. One tombstone settles everything before it, too.
void ModuleRuntime::skip(Skipped skipped) {
  const std::uint64_t last = skipped.below - 1;
  host_.skip(index_, last);
  for (const transport::Channel* output : outputs_)
    output->publish({nullptr, skipped.origin_ns, last});
}

void ModuleRuntime::tell_all(const std::vector<Lost>& lost) {
  for (const Lost& range : lost)
    for (std::uint64_t sequence = range.first; sequence <= range.last; ++sequence)
      host_.dropped(index_, sequence, range.reason);
}

}  // namespace xauto::runtime
