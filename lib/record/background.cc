// SPDX-License-Identifier: Apache-2.0
#include "record/background.h"

#include <algorithm>
#include <exception>
#include <utility>

#include "base/clock.h"
#include "base/futex.h"
#include "base/log.h"
#include "base/rt.h"
#include "base/thread.h"
#include "record/xauto_msgs.h"

namespace xauto::record {

BackgroundRecorder::BackgroundRecorder(Recorder recorder, std::size_t queue_bytes)
    : queue_bytes_(queue_bytes), recorder_(std::move(recorder)) {
  recorder_.give_away();
}

Result<std::unique_ptr<BackgroundRecorder>> BackgroundRecorder::start(Recorder recorder,
                                                                      std::size_t queue_bytes) {
  std::unique_ptr<BackgroundRecorder> background(
      new BackgroundRecorder(std::move(recorder), queue_bytes));
  XAUTO_ASSIGN(background->thread_, start_thread([b = background.get()] { b->run(); }));
  return background;
}

BackgroundRecorder::~BackgroundRecorder() {
  (void)close();
}

void BackgroundRecorder::ring(std::atomic<std::uint32_t>& word) {
  word.fetch_add(1);
  futex_wake_local(word, 1);
}

void BackgroundRecorder::write_enclosed(std::size_t topic, std::int64_t timestamp_ns,
                                        std::uint64_t number, std::vector<std::byte> data,
                                        IfFull if_full) {
  put({topic, timestamp_ns, number, std::move(data)}, if_full);
}

void BackgroundRecorder::write(std::size_t topic, std::int64_t timestamp_ns,
                               std::vector<std::byte> data, IfFull if_full) {
  put({topic, timestamp_ns, {}, std::move(data)}, if_full);
}

void BackgroundRecorder::put(Item item, IfFull if_full) {
  const std::size_t bytes = item.data.size();
  for (;;) {
    if (failed_.load()) return;
    const std::uint32_t seen = emptied_.load();
    {
      const Guard lock(mutex_);
      // One message always has room, however large it is.
      if (bytes_ == 0 || bytes_ + bytes <= queue_bytes_) {
        bytes_ += bytes;
        queue_.push_back(std::move(item));
        break;
      }
      if (if_full == IfFull::kLose) {
        ++lost_;
        return;
      }
    }
    futex_wait_local(emptied_, seen);
  }
  ring(filled_);
}

/// The first failure ends the recording.
void BackgroundRecorder::take(Status done) {
  if (done) return;
  status_ = std::move(done);
  failed_.store(true);
  log::warn("recording ended early: {}", status_.error().what);
}

void BackgroundRecorder::write(Item item) {
  if (failed_.load()) return;
  try {
    take(recorder_.write(
        item.topic, item.timestamp_ns,
        item.number ? enclose(item.timestamp_ns, *item.number, item.data) : item.data));
  } catch (const std::exception& e) {  // no memory
    take(fail(ErrorCode::kIo, e.what()));
  }
  if (unflushed_since_ns_ == 0) unflushed_since_ns_ = now_ns();
}

void BackgroundRecorder::flush_if_due() {
  if (unflushed_since_ns_ == 0 || now_ns() - unflushed_since_ns_ < kFlushNs || failed_.load())
    return;
  take(recorder_.flush());
  unflushed_since_ns_ = 0;
}

void BackgroundRecorder::run() {
  rt::set_thread_name("xauto/record");
  (void)rt::set_other();    // not what the creating thread has: nothing of the app waits for it
  take(recorder_.flush());  // the topics: who is killed at once leaves a recording without messages
  for (;;) {
    const std::uint32_t seen = filled_.load();
    std::optional<Item> item;
    bool closing = false;
    {
      const Guard lock(mutex_);
      closing = closing_;
      if (!queue_.empty()) {
        item = std::move(queue_.front());
        queue_.pop_front();
      }
    }
    if (!item && closing) break;
    if (!item) {
      futex_wait_local(filled_, seen,
                       unflushed_since_ns_ == 0
                           ? -1
                           : std::max<std::int64_t>(unflushed_since_ns_ + kFlushNs - now_ns(), 1));
    } else {
      const std::size_t bytes = item->data.size();
      write(std::move(*item));
      {
        const Guard lock(mutex_);
        bytes_ -= bytes;
      }
      ring(emptied_);
    }
    flush_if_due();
  }
}

Status BackgroundRecorder::close() {
  if (!thread_.joinable()) return {};
  {
    const Guard lock(mutex_);
    closing_ = true;
  }
  ring(filled_);
  thread_.join();
  recorder_.give_away();
  Status closed = recorder_.close();
  if (!status_) {
    Error error = status_.error();
    error.what = "recording ended early: " + error.what;
    return tl::unexpected<Error>(std::move(error));
  }
  const Guard lock(mutex_);
  if (closed && lost_ > 0)
    return fail(ErrorCode::kIo,
                std::to_string(lost_) + " messages are missing: writing did not keep up");
  return closed;
}

}  // namespace xauto::record
