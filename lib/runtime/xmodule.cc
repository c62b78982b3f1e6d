// SPDX-License-Identifier: Apache-2.0
#include "runtime/xmodule.h"

#include <algorithm>
#include <utility>

#include <uapi/xauto/event.h>

namespace xauto::runtime {

ModuleRuntime::ModuleRuntime(const Graph& graph, int index, ModuleHost& host,
                             std::vector<const transport::Channel*> outputs,
                             std::vector<detail::MessageMemory*> memories)
    : module_(graph.modules[static_cast<std::size_t>(index)]),
      numbered_(module_.numbered),
      tells_origins_(graph.tells_origins),
      index_(index),
      host_(host),
      outputs_(std::move(outputs)),
      memories_(std::move(memories)),
      topics_(module_.spec->inputs),
      state_(module_.spec->make_state()),
      queues_(topics_.size()),
      newest_(module_.spec->samples.size()),
      shift_ns_(topics_.size(), 0) {
  for (const detail::SampleSpec& sample : module_.spec->samples) topics_.push_back(sample.topic);
  InputAccess::bind(input_, &topics_, queues_.size());
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
  std::uint64_t skip_below = 0;
  bool start = false;
  {
    const Guard lock(mutex_);
    InputQueue& queue = queues_[static_cast<std::size_t>(input)];
    if (numbered_ && envelope.sequence < next_) return;  // of a release that is already lost
    arrive(queue, envelope, lost);
    put_off(lost);
    start = !busy_ && take_if_fresh(lost);
    if (!busy_ || hung_) skip_below = std::exchange(skip_below_, 0);
  }
  tell(lost, skip_below);
  if (start) host_.activate(index_);
}

/// Called with the mutex held.
void ModuleRuntime::arrive(InputQueue& queue, const detail::Envelope& envelope,
                           std::vector<Lost>& lost) {
  if (hung_) return lose_while_hung(queue, envelope, lost);
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
  const bool skip = overload_.kind == Overload::Kind::kSkip && busy_ && envelope.message != nullptr;
  if (numbered_) {
    if (gap) settle(envelope.sequence, XAUTO_DROP_OVERRUN, lost);
    if (envelope.message == nullptr)
      settle(envelope.sequence + 1, XAUTO_DROP_UPSTREAM, lost);
    else if (skip)
      settle(envelope.sequence + 1, XAUTO_DROP_OVERRUN, lost);
    else if (!queue.waiting.empty())
      settle(queue.waiting.front().sequence + 1, XAUTO_DROP_OVERRUN, lost);
  } else if (skip) {
    lost.push_back({envelope.sequence, envelope.sequence, XAUTO_DROP_OVERRUN});
  } else if (!queue.waiting.empty()) {
    const std::uint64_t old = queue.waiting.front().sequence;
    lost.push_back({old, old, XAUTO_DROP_OVERRUN});
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
        settle(queue.waiting.front().sequence + 1, XAUTO_DROP_UPSTREAM, lost);
        again = true;
      }
  }
}

/// Every release below `below` that is not settled yet is lost. Called with the mutex held.
void ModuleRuntime::settle(std::uint64_t below, std::uint32_t reason, std::vector<Lost>& lost) {
  if (below <= next_) return;
  lost.push_back({next_, below - 1, reason});
  next_ = below;
  skip_below_ = below;
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

/// By source, the oldest of what this activation is made from.
void ModuleRuntime::gather_origins() {
  auto origins = std::make_shared<detail::Origins>();
  origins->fill(0);
  const std::vector<detail::Envelope>& messages = InputAccess::messages(input_);
  for (std::size_t m = 0; m < messages.size(); ++m) {
    if (messages[m].origins == nullptr) continue;
    const detail::Origins& of = *messages[m].origins;
    const std::uint32_t onward = m < newest_from_ ? ~0u : module_.sample_origins[m - newest_from_];
    for (std::size_t i = 0; i < origins->size(); ++i)
      if (of[i] != 0 && (onward >> i & 1u) != 0 && ((*origins)[i] == 0 || of[i] < (*origins)[i]))
        (*origins)[i] = of[i];
  }
  origins_ = std::move(origins);
}

/// Moves the fresh messages into the activation's input. Called with the mutex held.
bool ModuleRuntime::take_if_fresh(std::vector<Lost>& lost) {
  if (overload_.kind == Overload::Kind::kQueue) resolve(lost);  // only there do losses wait
  if (queues_[empty_].waiting.empty()) return false;
  if (match_ns_ >= 0 && !numbered_ && !matched(lost)) return false;
  for (empty_ = 0; empty_ < queues_.size() && !queues_[empty_].waiting.empty();) ++empty_;
  if (empty_ < queues_.size()) return false;
  empty_ = 0;
  std::int64_t released_ns = INT64_MAX;
  std::uint64_t sequence = 0;
  for (std::size_t i = 0; i < queues_.size(); ++i) {
    const detail::Envelope& first = queues_[i].waiting.front();
    if (first.origin_ns - shift_ns_[i] >= released_ns) continue;
    released_ns = first.origin_ns - shift_ns_[i];
    sequence = first.sequence;
  }
  InputAccess::stamp(input_, released_ns, sequence);
  std::vector<detail::Envelope>& messages = InputAccess::messages(input_);
  for (std::size_t i = 0; i < queues_.size(); ++i) {
    messages[i] = std::move(queues_[i].waiting.front());
    queues_[i].waiting.pop_front();
  }
  if (numbered_) {
    settle(sequence, XAUTO_DROP_OVERRUN, lost);
    next_ = std::max(next_, sequence + 1);
  }
  busy_ = true;
  return true;
}

void ModuleRuntime::begin(std::int64_t now_ns) {
  InputAccess::begin(input_, now_ns);
  if (!module_.samples.empty()) {
    const Guard lock(mutex_);
    std::vector<detail::Envelope>& messages = InputAccess::messages(input_);
    for (std::size_t i = 0; i < newest_.size(); ++i) {
      const std::int64_t limit_ns = module_.spec->samples[i].max_age_ns;
      const bool fresh = limit_ns == 0 || now_ns - newest_[i].origin_ns <= limit_ns;
      messages[newest_from_ + i] = fresh ? newest_[i] : detail::Envelope{};
    }
  }
  if (tells_origins_) gather_origins();
}

/// Called with the mutex held.
void ModuleRuntime::put_off(std::vector<Lost>& lost) {
  if (!numbered_ || !busy_ || hung_) return;
  for (const Lost& range : lost) {
    if (!later_.empty() && later_.back().reason == range.reason &&
        later_.back().last + 1 == range.first)
      later_.back().last = range.last;
    else
      later_.push_back(range);
  }
  lost.clear();
}

void ModuleRuntime::tell(const std::vector<Lost>& lost, std::uint64_t skip_below) {
  for (const Lost& range : lost)
    for (std::uint64_t sequence = range.first; sequence <= range.last; ++sequence)
      host_.dropped(index_, sequence, range.reason);
  if (skip_below == 0) return;
  host_.skip(index_, skip_below - 1);
  // One tombstone settles everything before it, too.
  for (const transport::Channel* output : outputs_) output->publish({nullptr, 0, skip_below - 1});
}

std::int64_t ModuleRuntime::origin_of(std::size_t input) {
  return InputAccess::messages(input_)[input].origin_ns;
}

void ModuleRuntime::finish(bool succeeded) {
  if (watched_) {
    Fate open = Fate::kOpen;
    if (!fate_.compare_exchange_strong(open, Fate::kEnding)) return finish_abandoned();
  }
  const std::int64_t origin_ns = input_.origin().count();
  const std::uint64_t sequence = input_.sequence();
  if (succeeded) {
    try {
      for (std::size_t i = 0; i < module_.spec->outputs.size(); ++i) {
        const detail::OutputSpec& output = module_.spec->outputs[i];
        taken_.push_back(output.take(state_.get(), memories_[i]));
      }
    } catch (...) {  // a user's copy constructor: as if the last exec had failed
      succeeded = false;
    }
  }
  if (succeeded) {
    host_.done(index_, origin_ns, sequence);
    for (std::size_t i = 0; i < taken_.size(); ++i)
      outputs_[i]->publish({std::move(taken_[i]), origin_ns, sequence, origins_});
  }
  taken_.clear();
  bool again;
  std::uint64_t skip_below = 0;
  std::vector<Lost> lost;
  if (!succeeded) lost.push_back({sequence, sequence, XAUTO_DROP_FAILED});
  {
    const Guard lock(mutex_);
    for (detail::Envelope& message : InputAccess::messages(input_)) message = {};
    busy_ = false;
    if (watched_) fate_.store(Fate::kOpen);
    if (!succeeded && numbered_) skip_below_ = std::max(skip_below_, sequence + 1);
    lost.insert(lost.end(), later_.begin(), later_.end());
    later_.clear();
    again = take_if_fresh(lost);
    skip_below = std::exchange(skip_below_, 0);
  }
  tell(lost, skip_below);
  if (again) host_.activate(index_);
}

bool ModuleRuntime::abandon(std::uint64_t sequence) {
  std::vector<Lost> lost;
  std::uint64_t skip_below = 0;
  {
    const Guard lock(mutex_);
    Fate open = Fate::kOpen;
    if (!busy_ || input_.sequence() != sequence ||
        !fate_.compare_exchange_strong(open, Fate::kAbandoned))
      return false;
    hung_ = true;
    lost.push_back({sequence, sequence, XAUTO_DROP_HUNG});
    if (numbered_) skip_below_ = std::max(skip_below_, sequence + 1);
    lost.insert(lost.end(), later_.begin(), later_.end());
    later_.clear();
    for (InputQueue& queue : queues_)
      for (auto waiting = std::exchange(queue.waiting, {}); !waiting.empty(); waiting.pop_front())
        lose_while_hung(queue, waiting.front(), lost);
    skip_below = std::exchange(skip_below_, 0);
  }
  tell(lost, skip_below);
  return true;
}

/// It returned after all; what it did is lost, and known to be.
void ModuleRuntime::finish_abandoned() {
  const Guard lock(mutex_);
  for (detail::Envelope& message : InputAccess::messages(input_)) message = {};
  busy_ = false;
  hung_ = false;
  fate_.store(Fate::kOpen);
}

}  // namespace xauto::runtime
