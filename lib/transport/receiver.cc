// SPDX-License-Identifier: Apache-2.0
#include "transport/receiver.h"

#include <algorithm>

#include "base/thread.h"

namespace xauto::transport {

void Receiver::add(int tag, std::shared_ptr<Subscriber> subscriber, bool blank, Deliver deliver) {
  const Guard lock(mutex_);
  auto* const shared_memory = dynamic_cast<ShmSubscriber*>(subscriber.get());
  inputs_.push_back({tag, std::move(subscriber), shared_memory, blank, std::move(deliver)});
  doorbell_.ring();
}

void Receiver::remove(int tag) {
  const Guard lock(mutex_);
  for (const Input& input : inputs_)
    if (input.tag == tag) lost_before_ += input.subscriber->lost();
  std::erase_if(inputs_, [&](const Input& input) { return input.tag == tag; });
}

Status Receiver::start(std::function<void()> enter) {
  XAUTO_ASSIGN(thread_, start_thread([this, enter = std::move(enter)] {
                 enter();
                 run();
               }));
  return {};
}

void Receiver::stop() {
  // The second time the doorbell may be gone: in a member its memory goes before the receiver.
  if (!thread_.joinable()) return;
  stop_.store(true);
  doorbell_.ring();
  thread_.join();
}

std::uint64_t Receiver::lost() const {
  const Guard lock(mutex_);
  std::uint64_t sum = lost_before_;
  for (const Input& input : inputs_) sum += input.subscriber->lost();
  return sum;
}

bool Receiver::idle() const {
  const Guard lock(mutex_);
  return std::all_of(inputs_.begin(), inputs_.end(),
                     [](const Input& input) { return input.subscriber->empty(); });
}

std::optional<detail::Envelope> Receiver::take(const Input& input) {
  if (input.shared_memory != nullptr)
    return input.blank ? input.shared_memory->take_blank() : input.shared_memory->take();
  return input.blank ? input.subscriber->take_blank() : input.subscriber->take();
}

/// One message of each input in turn, so that a fast topic does not hold up the others.
bool Receiver::pass() {
  const Guard lock(mutex_);
  bool any = false;
  for (const Input& input : inputs_) {
    const auto envelope = take(input);
    if (!envelope) continue;
    any = true;
    input.deliver(*envelope);
  }
  return any;
}

void Receiver::run() {
  while (!stop_.load(std::memory_order_relaxed)) {
    if (pass()) continue;
    doorbell_.wait([this] { return !stop_.load(std::memory_order_relaxed) && idle(); });
  }
}

}  // namespace xauto::transport
