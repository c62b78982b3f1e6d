// SPDX-License-Identifier: Apache-2.0
#include "launch/foreign_work.h"

#include <algorithm>
#include <charconv>
#include <filesystem>
#include <limits>
#include <span>
#include <string>
#include <system_error>

#include <unistd.h>

#include "base/clock.h"
#include "base/log.h"
#include "base/rt.h"
#include "base/thread.h"
#include "kernel/queue_files.h"

namespace xauto::launch {
namespace {

namespace fs = std::filesystem;

constexpr int kManagerFifo = 59;  ///< below the coordinators
constexpr int kStepMs = 20, kConnectMs = 500;
constexpr std::int64_t kFeedNs = 200'000'000;  ///< the module's watchdog bites after a second
constexpr std::int64_t kReconnectNs = 50'000'000;
constexpr std::size_t kMostQueues = 256;  ///< that one owner may have of xauto.ko
constexpr coord::Key kLargest = std::numeric_limits<coord::Key>::max();

}  // namespace

Result<std::unique_ptr<ForeignWork>> ForeignWork::start(Options options) {
  XAUTO_ASSIGN(kernel::QueueControl control, kernel::QueueControl::open());
  auto work = std::unique_ptr<ForeignWork>(new ForeignWork(std::move(options), std::move(control)));
  XAUTO_ASSIGN(work->looker_, start_thread([at = work.get()] { at->look_often(); }));
  XAUTO_ASSIGN(work->manager_, start_thread([at = work.get()] { at->manage(); }));
  return work;
}

ForeignWork::~ForeignWork() {
  stop_.store(true);
  {
    const Guard lock(mutex_);
    if (interruptible_ != nullptr) interruptible_->interrupt();
  }
  if (looker_.joinable()) looker_.join();
  if (manager_.joinable()) manager_.join();
}

void ForeignWork::set_joined(std::set<pid_t> processes) {
  const Guard lock(mutex_);
  joined_ = std::move(processes);
  others_joined_.store(true);
}

bool ForeignWork::has_joined(pid_t process) {
  const Guard lock(mutex_);
  return joined_.contains(process);
}

// ---- who is there -------------------------------------------------------------------------------

void ForeignWork::look_often() {
  rt::set_thread_name("foreign/look");
  std::int64_t next = 0;
  while (!stop_.load()) {
    if (now_ns() < next) {
      sleep_until_ns(std::min(next, now_ns() + std::int64_t{kStepMs} * 1'000'000));
      continue;
    }
    next = now_ns() + kLookNs;
    std::vector<Found> found = look();
    const Guard lock(mutex_);
    new_ = std::move(found);
    looked_ = true;
  }
}

std::vector<ForeignWork::Found> ForeignWork::look() {
  std::set<pid_t> joined;
  {
    const Guard lock(mutex_);
    joined = joined_;
  }
  std::vector<Found> found;
  std::error_code error;
  for (fs::directory_iterator at("/proc", error), end; !error && at != end; at.increment(error)) {
    const std::string name = at->path().filename().string();
    pid_t process = 0;
    const auto [rest, wrong] = std::from_chars(name.data(), name.data() + name.size(), process);
    if (wrong != std::errc() || rest != name.data() + name.size() || process == getpid() ||
        joined.contains(process))
      continue;
    const auto files = kernel::find_queue_files(process);
    if (!files) continue;
    for (const kernel::QueueFile& file : *files) {
      if (file.type != options_.type || file.instance != options_.instance) continue;
      if (found.size() == kMostQueues) {
        not_kept_off_.fetch_add(1);
        return found;
      }
      // One that has closed it meanwhile has none.
      if (auto fd = kernel::take_descriptor(process, file.fd))
        found.push_back({process, std::move(*fd)});
    }
  }
  return found;
}

// ---- a worker like others -----------------------------------------------------------------------

void ForeignWork::manage() {
  rt::set_thread_name("foreign");
  rt::set_timer_slack_1ns();
  (void)rt::set_fifo_up_to(kManagerFifo);
  while (!stop_.load()) {
    if (!port_ && !connect()) {
      sleep_until_ns(now_ns() + kReconnectNs);
      continue;
    }
    if (others_joined_.exchange(false)) forget_joined();
    take_found();
    follow_job();
    feed(now_ns());
    const coord::Command command = port_->wait_command(looks_ ? 0 : kStepMs);
    carry_out(command);
    if (command == coord::Command::kLost) break;  // nobody orders the XPU any more
  }
  let_run(true);
  slot_.store(-1);
  {
    const Guard lock(mutex_);
    interruptible_ = nullptr;
  }
  port_.reset();  // its job is over, and who waits for the XPU has it
}

bool ForeignWork::connect() {
  auto port =
      coord::Port::connect(options_.door, "work of others", {0}, {}, kManagerFifo, kConnectMs);
  if (!port) {
    log::debug("{}", port.error().to_string());
    return false;
  }
  port_ = std::move(*port);
  {
    const Guard lock(mutex_);
    interruptible_ = port_.get();
  }
  slot_.store(port_->slot());
  return true;
}

/// One after the other, for a command may come meanwhile. A queue that is known has its handle again; one that has another
/// file behind its number is new.
void ForeignWork::take_found() {
  if (!looks_) {
    const Guard lock(mutex_);
    if (!std::exchange(looked_, false)) return;
    found_ = std::move(new_);
    looks_ = true;
    still_.clear();
  }
  if (!found_.empty()) return take_one();
  looks_ = false;
  forget([&](std::uint32_t handle, pid_t) { return !still_.contains(handle); });
  others_ns_ = port_->others_had_ns();
}

/// Its queues are its own business from now on.
void ForeignWork::forget_joined() {
  forget([&](std::uint32_t, pid_t process) { return has_joined(process); });
}

template <class Which>
void ForeignWork::forget(Which which) {
  for (auto at = handles_.begin(); at != handles_.end();) {
    if (!which(at->first, at->second)) {
      ++at;
      continue;
    }
    (void)control_.unregister(at->first);
    at = handles_.erase(at);
  }
  queues_.store(static_cast<std::uint32_t>(handles_.size()));
}

void ForeignWork::take_one() {
  const Found one = std::move(found_.back());
  found_.pop_back();
  if (has_joined(one.process)) return;  // since that look began
  const auto queue = control_.register_queue(options_.type, one.fd.get(), one.process);
  if (!queue) {
    // Its process has gone, or it is one that the module does not take.
    if (queue.error().code != ErrorCode::kUnavailable) {
      if (not_kept_off_.fetch_add(1) == 0)
        log::warn("a queue of process {} cannot be suspended: {}", one.process,
                  queue.error().to_string());
    }
    return;
  }
  still_.insert(queue->handle);
  if (!handles_.emplace(queue->handle, one.process).second) return;
  queues_.store(static_cast<std::uint32_t>(handles_.size()));
  const bool beside = !runs_ || (begun_ && taken_) || port_->others_had_ns() != others_ns_;
  if (beside) not_kept_off_.fetch_add(1);
  log::info("process {} has a queue there that no run knows{}", one.process,
            beside ? ": it may have run beside a job until now" : "");
  if (!runs_) suspend(queue->handle);
}

/// It has a job as long as there are queues.
void ForeignWork::follow_job() {
  if (handles_.empty() == !begun_) {
    if (begun_) let_run(!taken_ && port_->may_run());
    return;
  }
  if (!begun_) {
    begun_ = true;
    taken_ = false;
    port_->begin({.xnode = 0,
                  .sequence = 1,
                  .key = kLargest,
                  .since_ns = static_cast<std::uint64_t>(now_ns())});
    return let_run(port_->may_run());
  }
  if (taken_ || !port_->may_run()) return;  // until it has the XPU again
  port_->finish();
  begun_ = false;
  let_run(true);
}

void ForeignWork::carry_out(coord::Command command) {
  switch (command) {
    case coord::Command::kSuspend:
      taken_ = begun_;
      if (begun_) let_run(false);
      return port_->acknowledge(true);  // what is not suspended is counted: nobody waits for it
    case coord::Command::kResume:
      taken_ = false;
      let_run(!begun_ || port_->may_run());
      return port_->acknowledge(true);
    case coord::Command::kLost:
    case coord::Command::kInterrupted:
    case coord::Command::kNothing:
      return;
  }
}

void ForeignWork::let_run(bool run) {
  if (run == runs_) return;
  runs_ = run;
  if (run) {
    for (const auto& [handle, process] : handles_) (void)control_.resume(handle);
    return;
  }
  fed_ns_ = now_ns();
  suspensions_.fetch_add(1);
  std::vector<kernel::QueueOp> ops;
  for (const auto& [handle, process] : handles_) ops.push_back({XAUTO_ACTION_SUSPEND, handle, 0});
  const std::span<const kernel::QueueOp> all(ops);
  for (std::size_t at = 0; at < all.size(); at += XAUTO_MAX_OPS) {
    const auto part = all.subspan(at, std::min<std::size_t>(XAUTO_MAX_OPS, all.size() - at));
    if (control_.control(part)) continue;
    for (const kernel::QueueOp& op : part) suspend(op.handle);
  }
}

void ForeignWork::suspend(std::uint32_t handle) {
  const Status done = control_.suspend(handle);
  if (done) return;
  const auto info = control_.query(handle);
  if (!info) return;  // its process has closed it
  if (not_kept_off_.fetch_add(1) == 0)
    log::warn("a queue of process {} could not be suspended: {}", info->pid,
              done.error().to_string());
}

void ForeignWork::feed(std::int64_t now) {
  if (runs_ || handles_.empty() || now - fed_ns_ < kFeedNs) return;
  fed_ns_ = now;
  const Status fed = control_.feed_watchdog();
  if (fed || fed.error().code != ErrorCode::kTimeout) return;
  not_kept_off_.fetch_add(1);
  runs_ = true;
  let_run(false);
}

}  // namespace xauto::launch
