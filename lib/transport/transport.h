// SPDX-License-Identifier: Apache-2.0
// What the runtime asks of whatever carries a topic out of its process. The default is our own
// shared memory (shm_topic.h); plug-ins carry it elsewhere (bridge.h). Inside a process a topic is
// a pointer (topic.h).
//
//   publishing:  loan room, make the message there, sender()(envelope)       never waits
//   reading:     wait on a Doorbell (doorbell.h), take() until it has nothing
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include <xauto/result.h>

#include "base/unique_fd.h"
#include "model/message.h"

namespace xauto::transport {

/// The writing end. Threads: any of one process.
class Publisher : public detail::MessageMemory {
 public:
  using Sender = std::function<void(const detail::Envelope&)>;

  /// Never waits: what a reader has no room for is lost for that reader. An envelope without a
  /// message is a tombstone.
  virtual void publish(const detail::Envelope& envelope) = 0;
  /// The same as a callable, made once at set-up: bound to the transport's own class, so that a
  /// message costs no virtual call. Valid as long as the publisher is.
  [[nodiscard]] virtual Sender sender() = 0;
  /// One beyond the last release that went out.
  [[nodiscard]] virtual std::uint64_t next_sequence() const = 0;
  /// Messages that could not be sent to anybody.
  [[nodiscard]] virtual std::uint64_t unsent() const = 0;
  /// How many readers it has found, of a transport that finds them.
  [[nodiscard]] virtual std::size_t readers() const { return 0; }
};

/// The reading end of one process. Threads: `take` from one; the messages from any.
class Subscriber {
 public:
  Subscriber() = default;
  virtual ~Subscriber() = default;
  Subscriber(const Subscriber&) = delete;
  Subscriber& operator=(const Subscriber&) = delete;

  /// The next message or tombstone; nullopt: none. Never waits.
  [[nodiscard]] virtual std::optional<detail::Envelope> take() = 0;
  /// The same without ever touching the message: for whoever stands in for a dead reader.
  [[nodiscard]] virtual std::optional<detail::Envelope> take_blank() = 0;
  [[nodiscard]] virtual bool empty() const = 0;
  /// Messages that came too fast for this reader, or were not acceptable.
  [[nodiscard]] virtual std::uint64_t lost() const = 0;
  /// How many publishers it has found, of a transport that finds them.
  [[nodiscard]] virtual std::size_t publishers() const { return 0; }
  /// Messages that a newer one has replaced before they were taken, where only the newest waits.
  [[nodiscard]] virtual std::uint64_t replaced() const { return 0; }
};

/// Where a publisher rings after it has put something into somebody's queue; see doorbell.h.
class Ringer {
 public:
  virtual ~Ringer() = default;
  virtual void ring(std::uint32_t subscriber) = 0;
};

/// One topic between the processes of an app, as one of them has it: what makes its ends there. The
/// process that made it (make_link, shm_topic.h) gives the others descriptors to join it with.
class Link {
 public:
  Link() = default;
  virtual ~Link() = default;
  Link(const Link&) = delete;
  Link& operator=(const Link&) = delete;

  /// `ringer`: rung for each reader after a message; null: nobody is.
  [[nodiscard]] virtual Result<std::shared_ptr<Publisher>> publisher(const detail::TopicSpec& topic,
                                                                     Ringer* ringer) = 0;
  [[nodiscard]] virtual Result<std::shared_ptr<Subscriber>> subscriber(
      const detail::TopicSpec& topic, std::uint32_t reader) = 0;
  /// For the process that publishes it (`reader` -1), or is this reader of it.
  [[nodiscard]] virtual Result<std::vector<UniqueFd>> invite(int reader) const = 0;
  /// One beyond the last release that went out, from whichever process.
  [[nodiscard]] virtual std::uint64_t next_sequence() const = 0;
  /// The process of this reader is dead: it holds no message any more.
  virtual void release_all(std::uint32_t reader) = 0;
};

}  // namespace xauto::transport
