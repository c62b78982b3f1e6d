// SPDX-License-Identifier: Apache-2.0
#include "kernel/rm_queues.h"

#include <algorithm>
#include <cerrno>
#include <string>
#include <tuple>

#include <sys/ioctl.h>

#include "base/clock.h"
#include "base/unique_fd.h"
#include "kernel/rm.h"
#include "kernel/watched.h"

namespace xauto::kernel {
namespace {

auto* list_channels() {
  static auto* const list =
      watch_function<decltype(xauto_watched_channels_1)>("xauto_watched_channels_1");
  return list;
}

std::vector<xauto_watched_channel> watched_channels() {
  return all_watched(list_channels());
}

void forget_client(std::uint32_t client) {
  static auto* const forget =
      watch_function<decltype(xauto_watched_client_is_gone_1)>("xauto_watched_client_is_gone_1");
  if (forget != nullptr) forget(client);
}

std::string target_of(const xauto_watched_channel& channel) {
  return "rm:" + std::to_string(channel.client) + ":" + std::to_string(channel.group) + ":" +
         std::to_string(channel.made);
}

bool is_gone(std::uint32_t status) {
  return status == rm::kInvalidClient || status == rm::kInvalidObjectHandle ||
         status == rm::kObjectNotFound;
}

bool did_stay(std::uint32_t status) {
  return status == rm::kTimeout || status == rm::kTimeoutRetry || status == rm::kBusyRetry ||
         status == rm::kStateInUse;
}

/// Names the status; what a driver may answer here.
tl::unexpected<Error> failed(const char* what, std::uint32_t status, const std::string& where) {
  if (did_stay(status))
    return fail(ErrorCode::kTimeout, "did not leave its engine in time", where,
                "split its kernels");
  if (is_gone(status)) return fail(ErrorCode::kUnavailable, "is gone", where);
  if (status == rm::kGpuIsLost)
    return fail(ErrorCode::kUnavailable, "the GPU is lost", where, "see the kernel's log");
  if (status == rm::kNotSupported)
    return fail(
        ErrorCode::kUnavailable, "this driver runs without GSP firmware and refuses", where,
        "load nvidia.ko with NVreg_EnableGpuFirmware=1, or plan with \"preemptive\": false");
  return fail(ErrorCode::kIo, std::string(what) + ": RM's status " + std::to_string(status), where);
}

/// A message to the GPU of `subdevice`.
struct Message {
  int fd;
  std::uint32_t client, subdevice;
  rm::DisableChannels params{};
};

/// 0, or what went wrong.
std::uint32_t send(Message& message) {
  const Duplicate copy(message.fd, rm::kControlNode);
  if (!copy) return rm::kInvalidClient;
  rm::Control call{.client = message.client,
                   .object = message.subdevice,
                   .command = rm::kDisableChannels,
                   .params = reinterpret_cast<std::uintptr_t>(&message.params),
                   .params_size = sizeof message.params};
  // Who answers and sets no status has not done it.
  call.status = rm::kInvalidClient;
  int result;
  do result = ioctl(copy.get(), rm::escape(rm::kControl, sizeof call), &call);
  while (result < 0 && errno == EINTR);
  if (result == 0) return call.status;
  return call.status == rm::kOk ? rm::kInvalidClient : call.status;
}

/// Of two statuses that which is to be tried again, before what is gone.
std::uint32_t worse(std::uint32_t a, std::uint32_t b) {
  return b != rm::kOk && (a == rm::kOk || !is_gone(b)) ? b : a;
}

/// Enables what is left of a message of which one channel is gone: RM refuses it whole.
std::uint32_t enable_each(const Message& message) {
  std::uint32_t done = rm::kOk;
  for (std::uint32_t i = 0; i < message.params.count; ++i) {
    Message one{message.fd, message.client, message.subdevice};
    one.params.count = 1;
    one.params.clients[0] = message.params.clients[i];
    one.params.channels[0] = message.params.channels[i];
    done = worse(done, send(one));
  }
  return done;
}

}  // namespace

bool rm_is_watched() {
  return list_channels() != nullptr;
}

std::vector<QueueFile> find_rm_groups() {
  std::vector<QueueFile> groups;
  for (const xauto_watched_channel& channel : watched_channels()) {
    QueueFile group{channel.fd, QueueType::kRmGroup, -1, target_of(channel)};
    if (std::find(groups.begin(), groups.end(), group) == groups.end())
      groups.push_back(std::move(group));
  }
  return groups;
}

Result<RmQueues::Handle> RmQueues::take(const QueueFile& group) {
  for (const auto& [handle, known] : groups_)
    if (known.file == group) return handle;
  const std::vector<QueueFile> all = find_rm_groups();
  if (std::find(all.begin(), all.end(), group) == all.end())
    return fail(ErrorCode::kUnavailable, "is no channel group of this process", group.target);
  groups_.emplace(++last_, Group{.file = group});
  return last_;
}

void RmQueues::give_back(Handle handle) {
  (void)resume({handle});
  groups_.erase(handle);
}

std::string RmQueues::names(const std::vector<Handle>& handles) const {
  std::string all;
  for (const Handle handle : handles)
    all += (all.empty() ? "" : ", ") + groups_.at(handle).file.target;
  return all;
}

std::uint32_t RmQueues::tell(const std::vector<Handle>& handles, bool disable) {
  const std::vector<xauto_watched_channel> channels = watched_channels();
  std::vector<Message> messages;
  for (const Handle handle : handles) {
    Group& group = groups_.at(handle);
    group.channels = 0;
    for (const xauto_watched_channel& channel : channels) {
      if (channel.fd != group.file.fd || target_of(channel) != group.file.target) continue;
      ++group.channels;
      auto it = std::find_if(messages.begin(), messages.end(), [&](const Message& m) {
        return std::tie(m.fd, m.client, m.subdevice) ==
                   std::tie(channel.fd, channel.client, channel.subdevice) &&
               m.params.count < rm::kMaxChannels;
      });
      if (it == messages.end())
        it = messages.insert(it, Message{channel.fd, channel.client, channel.subdevice});
      it->params.disable = disable ? 1 : 0;
      it->params.clients[it->params.count] = channel.client;
      it->params.channels[it->params.count++] = channel.channel;
    }
    if (group.channels == 0 && disable) return rm::kObjectNotFound;
  }
  std::uint32_t done = rm::kOk;
  for (Message& message : messages)
    if (std::uint32_t status = send(message); status != rm::kOk) {
      if (status == rm::kInvalidClient || status == rm::kInvalidObjectHandle)
        forget_client(message.client);
      if (disable) return status;  // what is resumed is resumed whole
      if (status == rm::kObjectNotFound) status = enable_each(message);
      done = worse(done, status);
    }
  return done;
}

Status RmQueues::suspend(const std::vector<Handle>& handles) {
  const std::int64_t begin = now_ns();
  for (const Handle handle : handles)
    if (!groups_.at(handle).suspended && !groups_.at(handle).patience.may(begin))
      return fail(ErrorCode::kUnavailable,
                  "did not leave its engine in time before, so it is not tried",
                  groups_.at(handle).file.target);
  const std::uint32_t status = tell(handles, true);
  for (const Handle handle : handles) {
    Group& group = groups_.at(handle);
    if (status == rm::kOk || did_stay(status))
      group.patience.waited(begin, now_ns(), did_stay(status));
    group.suspended = status == rm::kOk;
  }
  if (status == rm::kOk) return {};
  (void)resume(handles);  // half a suspension is none
  return failed("DISABLE_CHANNELS", status, names(handles));
}

Status RmQueues::resume(const std::vector<Handle>& handles) {
  for (const Handle handle : handles) groups_.at(handle).suspended = false;
  const std::uint32_t status = tell(handles, false);
  const bool owed = status != rm::kOk && !is_gone(status);
  for (const Handle handle : handles) groups_.at(handle).owed = owed;
  if (owed) return failed("enabling channels", status, names(handles));
  return {};
}

void RmQueues::again() {
  const std::vector<xauto_watched_channel> channels = watched_channels();
  for (auto& [handle, group] : groups_) {
    const auto now = static_cast<std::size_t>(
        std::count_if(channels.begin(), channels.end(), [&, &group = group](const auto& channel) {
          return target_of(channel) == group.file.target;
        }));
    if (group.suspended && now != group.channels)
      (void)tell({handle}, true);
    else if (group.owed)
      (void)resume({handle});
  }
}

bool RmQueues::owes() const {
  return std::any_of(groups_.begin(), groups_.end(),
                     [](const auto& entry) { return entry.second.owed; });
}

RmQueues::~RmQueues() {
  for (const auto& [handle, group] : groups_)
    if (group.suspended) (void)resume({handle});
  for (int i = 0; owes() && i < 3; ++i) again();
}

}  // namespace xauto::kernel
