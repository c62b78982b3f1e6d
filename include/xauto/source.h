// SPDX-License-Identifier: Apache-2.0
// Sources that are pushed into: a driver's callback publishes, and that is a release.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <utility>

#include <xauto/rate.h>
#include <xauto/result.h>
#include <xauto/topic.h>

namespace xauto {

namespace detail {

class Inlet;
/// Makes message number `sequence`, in `memory` if it is not null.
using Make =
    std::function<std::shared_ptr<const void>(std::uint64_t sequence, MessageMemory* memory)>;
using Observe = std::function<void(const void* message, std::uint64_t sequence)>;
using Judge = std::function<bool(const void* message, std::uint64_t sequence)>;

Status push(Inlet& inlet, std::shared_ptr<const void> message);
Status push_urgent(Inlet& inlet, std::shared_ptr<const void> message);

}  // namespace detail

/// What a release is, for Source::publish; App::add_source asks for it with its `urgent`.
enum class Release : std::uint8_t {
  ordinary,
  /// Its jobs, in all modules that the message reaches by edges, go before their turn, by what
  /// app.json states as "urgent" of the source. The policy's worst cases hold all the same: for the
  /// urgent release a shorter one, for all others the ordinary one. One that comes sooner after the
  /// urgent one before than app.json states is released as an ordinary one, and counted.
  urgent,
};

/// What pushed() returns, for App::add_source.
struct Pushed {
  std::chrono::microseconds distance;  ///< see pushed()
  Rate rate = {0};                     ///< exactly, where `num` is above 0
};

/// A source whose messages come when they come, `distance` (1 us to 1 h) apart or more. The solver
/// plans for `distance` as the period: declare the shortest one, jitter included. A message that
/// comes earlier is released all the same; the report counts them.
[[nodiscard]] inline Pushed pushed(std::chrono::microseconds distance) {
  return {distance};
}

/// The same of a source that comes at a rate: pushed(30_hz).
[[nodiscard]] inline Pushed pushed(Rate rate) {
  return {std::chrono::microseconds(rate.den * 1'000'000 / rate.num), rate};
}

/// The end of a pushed source at which messages go in; from App::add_source. A handle: copies are
/// the same source. It may outlive the App. Threads: any.
template <class T>
class Source {
 public:
  /// For App::add_source.
  explicit Source(std::shared_ptr<detail::Inlet> inlet) : inlet_(std::move(inlet)) {}

  /// Publishes `message`: a release of the sensor, numbered from 0 on in each run, with the time of
  /// this call. Never waits for the app. With a recorded input it is discarded, and succeeds.
  ///
  /// Errors: kUnavailable where the app does not take messages: before App::on_start calls, after
  /// the run's end, in a process of the app that has not its sources. So it is where too many wait,
  /// since the app runs in lockstep and this is faster. Nothing is kept for later.
  /// kInvalid of an urgent release in a run that knows nothing of it. Such a run is by a policy
  /// without keys, or of an app.json that states no "urgent" of this source. Without an app.json (profile), with a
  /// recorded input, and in lockstep each release is an ordinary one.
  [[nodiscard]] Status publish(T message, Release release = Release::ordinary) const {
    return publish(std::make_shared<const T>(std::move(message)), release);
  }
  /// The same without a copy. kInvalid when it is null.
  [[nodiscard]] Status publish(std::shared_ptr<const T> message,
                               Release release = Release::ordinary) const {
    return release == Release::urgent ? detail::push_urgent(*inlet_, std::move(message))
                                      : detail::push(*inlet_, std::move(message));
  }

 private:
  std::shared_ptr<detail::Inlet> inlet_;
};

}  // namespace xauto
