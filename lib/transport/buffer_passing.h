// SPDX-License-Identifier: Apache-2.0
// How buffers of messages get into other processes: each descriptor once, over a socket pair beside the topic's shared memory;
// a message then has the buffer's number. The publisher tells a reader of a buffer before it puts the message into its queue,
// and the reader looks into the socket when it meets a number that it does not know: so nobody waits for anybody.
//
//   publisher ──► Known(number) + descriptor     of a memfd one for reading
//             ──► Forgotten(number)              the publisher has it no more, and no message has
//             ──► AllForgotten                   a new publisher, after one that died
//
// A number, from 1 on, is never used again. A reader that does not know one all the same (it is new, or had no descriptor left) loses that
// message, and asks to be told of all of them again by a word in shared memory (TopicQueue::asks).
#pragma once

#include <atomic>
#include <bitset>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <unordered_map>
#include <vector>

#include <xauto/result.h>

#include "base/thread_safety.h"
#include "base/unique_fd.h"
#include "transport/buffer.h"

namespace xauto::transport {

struct BufferPacket {
  enum class Word : std::uint32_t { kKnown = 1, kForgotten, kAllForgotten };
  std::uint32_t magic = 0, word = 0;
  std::uint64_t number = 0, size = 0;
};
inline constexpr std::uint32_t kBufferMagic = 0x58425546;  // "XBUF"

struct BufferEnds {
  UniqueFd publisher, reader;
};
[[nodiscard]] Result<BufferEnds> make_buffer_ends();

/// The publisher's side. Threads: one at a time.
class BufferSender {
 public:
  using Reached = std::bitset<64>;  ///< by reader

  /// `ends`: by reader. `numbers`: the next one, in memory that outlives a publisher.
  BufferSender(std::string topic, std::vector<UniqueFd> ends, std::atomic<std::uint64_t>& numbers);

  struct Told {
    std::uint64_t number = 0;
    Reached reached;  ///< who knows it
  };
  /// Never waits. `asks(reader)`: how often that reader has asked to be told again. Fails when too many are in use.
  [[nodiscard]] Result<Told> tell(const std::shared_ptr<detail::BufferMemory>& memory,
                                  const std::function<std::uint32_t(std::size_t)>& asks);

 private:
  struct Known {
    std::uint64_t number = 0;
    std::weak_ptr<detail::BufferMemory> memory;
    std::vector<std::uint64_t> told;  ///< by reader: what `asks` was then, plus 1; 0: not told
  };
  [[nodiscard]] bool send(std::size_t reader, BufferPacket::Word word, std::uint64_t number = 0,
                          std::size_t size = 0, int fd = -1);
  void forget_gone();
  void start_over(std::size_t reader);
  void warn(const std::string& text);

  const std::string topic_;
  std::vector<UniqueFd> ends_;
  std::vector<bool> cleared_;  ///< by reader: it was told to forget a predecessor's
  std::atomic<std::uint64_t>& numbers_;
  std::unordered_map<std::uint64_t, Known> known_;  ///< by serial
  bool warned_ = false;
};

/// A reader's side. Threads: one.
class BufferReceiver {
 public:
  BufferReceiver(std::string topic, UniqueFd end)
      : topic_(std::move(topic)), end_(std::move(end)) {}

  /// Null: it is not known, whatever has come until now.
  [[nodiscard]] std::shared_ptr<detail::BufferMemory> find(std::uint64_t number);
  /// Takes what has come, so that the socket does not stay full.
  void drain();
  [[nodiscard]] std::size_t known() const;
  /// The next thread that calls is another one; the caller orders the two.
  void give_away() { thread_.give_away(); }

 private:
  [[nodiscard]] Status take(const BufferPacket& packet, std::vector<UniqueFd> fds);
  void warn(const Error& error);

  OneThread thread_;
  const std::string topic_;
  UniqueFd end_;
  using Memories = std::unordered_map<std::uint64_t, std::shared_ptr<detail::BufferMemory>>;
  Memories known_;   ///< by number
  Memories before_;  ///< of a publisher that died: for its messages that wait yet
  bool warned_ = false;
};

}  // namespace xauto::transport
