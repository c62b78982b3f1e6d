// SPDX-License-Identifier: Apache-2.0
#include "transport/buffer_passing.h"

#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <sys/socket.h>

#include "base/log.h"
#include "base/memory_file.h"
#include "base/socket.h"

namespace xauto::transport {
namespace {

constexpr int kMostAtOnce = 4 * kMaxKnownBuffers;  ///< packets that one look takes

}  // namespace

Result<BufferEnds> make_buffer_ends() {
  int fds[2];
  if (socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | SOCK_NONBLOCK, 0, fds) != 0)
    return fail(ErrorCode::kIo, std::string("socketpair: ") + strerror(errno));
  return BufferEnds{UniqueFd(fds[0]), UniqueFd(fds[1])};
}

// ---- publishing --------------------------------------------------------------------------------

BufferSender::BufferSender(std::string topic, std::vector<UniqueFd> ends,
                           std::atomic<std::uint64_t>& numbers)
    : topic_(std::move(topic)), ends_(std::move(ends)), cleared_(ends_.size()), numbers_(numbers) {}

bool BufferSender::send(std::size_t reader, BufferPacket::Word word, std::uint64_t number,
                        std::size_t size, int fd) {
  const BufferPacket packet{kBufferMagic, static_cast<std::uint32_t>(word), number, size};
  const Status sent = send_packet(ends_[reader].get(), &packet, sizeof packet,
                                  fd < 0 ? std::vector<int>{} : std::vector<int>{fd});
  if (!sent)
    warn("reader " + std::to_string(reader) +
         " is not told of a buffer, and loses its messages: " + sent.error().what);
  return sent.has_value();
}

void BufferSender::warn(const std::string& text) {
  if (!std::exchange(warned_, true)) log::warn("topic '{}': {}", topic_, text);
}

/// A buffer that is gone is in no message either: messages have it.
void BufferSender::forget_gone() {
  for (auto at = known_.begin(); at != known_.end();) {
    if (!at->second.memory.expired()) {
      ++at;
      continue;
    }
    const Known gone = std::move(at->second);
    at = known_.erase(at);
    for (std::size_t r = 0; r < ends_.size(); ++r)
      if (gone.told[r] != 0 && !send(r, BufferPacket::Word::kForgotten, gone.number)) start_over(r);
  }
}

/// Its socket is full, and it is not to keep from the others what they need: when it looks again it forgets all.
void BufferSender::start_over(std::size_t reader) {
  cleared_[reader] = false;
  for (auto& [serial, known] : known_) known.told[reader] = 0;
}

Result<BufferSender::Told> BufferSender::tell(
    const std::shared_ptr<detail::BufferMemory>& memory,
    const std::function<std::uint32_t(std::size_t)>& asks) {
  auto at = known_.find(memory->serial());
  if (at == known_.end()) {
    forget_gone();
    if (known_.size() >= kMaxKnownBuffers) {
      warn("more than " + std::to_string(kMaxKnownBuffers) +
           " buffers at a time; messages are lost. Use them again (xauto::BufferPool)");
      return fail(ErrorCode::kUnavailable, "too many buffers");
    }
    Known fresh{numbers_.fetch_add(1) + 1, memory, std::vector<std::uint64_t>(ends_.size())};
    at = known_.emplace(memory->serial(), std::move(fresh)).first;
  }
  Known& known = at->second;
  Told told{known.number, {}};
  UniqueFd unwritable;
  for (std::size_t r = 0; r < ends_.size(); ++r) {
    const std::uint64_t asked = std::uint64_t{asks(r)} + 1;
    if (known.told[r] != asked) {
      int fd = memory->fd();
      if (!memory->is_dmabuf()) {  // a dmabuf cannot be opened a second time
        if (!unwritable) {
          auto opened = read_only(fd);
          if (opened)
            unwritable = std::move(*opened);
          else
            warn(opened.error().what + "; messages are lost. See `ulimit -n`");
        }
        fd = unwritable.get();
      }
      if (!cleared_[r]) cleared_[r] = send(r, BufferPacket::Word::kAllForgotten);
      if (fd < 0 || !cleared_[r] ||
          !send(r, BufferPacket::Word::kKnown, known.number, memory->size(), fd))
        continue;
      known.told[r] = asked;
    }
    told.reached.set(r);
  }
  return told;
}

// ---- reading -----------------------------------------------------------------------------------

std::shared_ptr<detail::BufferMemory> BufferReceiver::find(std::uint64_t number) {
  thread_.check();
  if (!known_.contains(number) && !before_.contains(number)) drain();
  if (const auto at = known_.find(number); at != known_.end()) {
    before_.clear();  // messages come in order: none of a predecessor's is left
    return at->second;
  }
  const auto at = before_.find(number);
  return at == before_.end() ? nullptr : at->second;
}

std::size_t BufferReceiver::known() const {
  thread_.check();
  return known_.size() + before_.size();
}

void BufferReceiver::drain() {
  thread_.check();
  for (int i = 0; i < kMostAtOnce; ++i) {
    BufferPacket packet;
    std::vector<UniqueFd> fds;
    const auto size = receive_packet(end_.get(), &packet, sizeof packet, &fds);
    if (!size && size.error().code == ErrorCode::kUnavailable) return;  // nothing more, or nobody
    if (!size)
      warn({ErrorCode::kIo,
            "a buffer's descriptor was lost on the way",
            {},
            "this process may have too few: see `ulimit -n`"});
    else if (*size != sizeof packet || packet.magic != kBufferMagic)
      warn({ErrorCode::kInvalid, "what came beside it is no word about a buffer", {}, {}});
    else if (const Status status = take(packet, std::move(fds)); !status)
      warn(status.error());
  }
}

Status BufferReceiver::take(const BufferPacket& packet, std::vector<UniqueFd> fds) {
  switch (static_cast<BufferPacket::Word>(packet.word)) {
    case BufferPacket::Word::kKnown: {
      if (fds.size() != 1)
        return fail(ErrorCode::kInvalid,
                    "a buffer came with " + std::to_string(fds.size()) + " descriptors, not 1");
      if (known_.contains(packet.number)) return {};  // told again
      if (packet.number == 0) return fail(ErrorCode::kInvalid, "a buffer has no number");
      if (known_.size() >= kMaxKnownBuffers)
        return fail(ErrorCode::kInvalid, "more than " + std::to_string(kMaxKnownBuffers) +
                                             " buffers were told of at a time");
      XAUTO_ASSIGN(auto memory, detail::BufferMemory::adopt(std::move(fds[0]), true));
      if (memory->size() != packet.size)
        return fail(ErrorCode::kInvalid, "a buffer said to have " + std::to_string(packet.size) +
                                             " bytes has " + std::to_string(memory->size()));
      known_.emplace(packet.number, std::move(memory));
      return {};
    }
    case BufferPacket::Word::kForgotten:
      known_.erase(packet.number);
      return {};
    case BufferPacket::Word::kAllForgotten:
      before_ = std::exchange(known_, {});
      return {};
  }
  return fail(ErrorCode::kInvalid, "an unknown word about a buffer");
}

void BufferReceiver::warn(const Error& error) {
  if (!std::exchange(warned_, true)) log::warn("topic '{}': {}", topic_, error.to_string());
}

}  // namespace xauto::transport
