// SPDX-License-Identifier: Apache-2.0
// One host's part of an app over several: the topics that cross, over DDS, and the watch of each X (crossing_reader.h).
//
//   Channel ─► Crossings ─► DDS ─► thread "xauto/crossings" of another host ─► CrossingReader ─► Channel
//
// A DDS topic has the number of the run in its name, and each message has it, too: what another run sends, or a part that
// was started for another one, is not heard.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <thread>
#include <vector>

#include <xauto/result.h>

#include "base/pi_mutex.h"
#include "grid/context.h"
#include "session/run_report.h"
#include "transport/bridge.h"

#include "parts/crossing_reader.h"

namespace xauto::parts {

/// Of a part of the run: when its releases begin on this host's clock, and from where on it takes part.
struct PartStart {
  std::int64_t start_ns = 0;  ///< CLOCK_MONOTONIC
  std::int64_t from_ns = 0;   ///< after the start: what is nominally released before is not for us
  /// The first release of these that it takes part in; `shift_ns`: of a source's against its component's.
  [[nodiscard]] std::uint64_t first(const runtime::Grid::Source& releases,
                                    std::int64_t shift_ns = 0) const;
};

/// Releases of the component of `module`: its k-th activation.
[[nodiscard]] Result<std::vector<runtime::Grid::Source>> releases_of_modules(
    const runtime::Graph& graph, const AppSpec& app);

/// Threads: one, apart from what it hands out.
class Crossings {
 public:
  /// Null: the run is not one part of several. `enter`: of BridgeOptions. Before any other bridge of this process, whose
  /// threads the first one makes. Errors: a topic that cannot cross, no plug-in, no DDS.
  [[nodiscard]] static Result<std::unique_ptr<Crossings>> open(const runtime::Context& context,
                                                               std::function<void()> enter);
  ~Crossings();
  Crossings(const Crossings&) = delete;
  Crossings& operator=(const Crossings&) = delete;

  /// What a topic's channel tells, for other hosts; null: it does not cross.
  [[nodiscard]] std::function<void(const detail::Envelope&)> sender(std::size_t topic);
  /// Every other host that reads from us, or that we read from, is there.
  [[nodiscard]] bool met() const;

  using Deliver = std::function<void(std::size_t topic, const detail::Envelope&)>;
  /// From here on messages come in, and go out. `enter`: on the new thread. Once.
  [[nodiscard]] Status start(const PartStart& start, Deliver deliver, std::function<void()> enter);
  /// What is nominally released `end_ns` after the start, or later, does not come: waits until all before is here, or its
  /// X is over. False: not within a minute.
  [[nodiscard]] bool finish(std::int64_t end_ns);
  /// Ends the ways in and out, after what waits has been sent.
  void stop();
  /// After `stop`: the crossings, and what DDS has to say. What was lost is on the board.
  void report(runtime::RunReport& into) const;

 private:
  struct Out;
  struct In;
  explicit Crossings(const runtime::Context& context);
  [[nodiscard]] Status open_out(std::size_t topic);
  [[nodiscard]] Status open_in(std::size_t topic, const runtime::Grid::Source& releases);
  void send(Out& out, const detail::Envelope& envelope) const;
  void run();
  bool take(In& in);
  void hear(In& in, const detail::Envelope& arrived, std::int64_t now_ns);
  void tell_losses(In& in);

  const runtime::Context& context_;
  transport::Doorbell arrived_;
  std::unique_ptr<transport::Bridge> bridge_;
  std::vector<std::unique_ptr<Out>> outs_;
  std::vector<std::unique_ptr<In>> ins_;
  std::atomic<std::int64_t> start_ns_{0};  ///< 0: nothing crosses yet
  std::atomic<std::int64_t> end_ns_{INT64_MAX};
  std::atomic<bool> stop_{false}, over_{false};
  Deliver deliver_;
  std::thread thread_;
};

}  // namespace xauto::parts
