// SPDX-License-Identifier: Apache-2.0
// The peers: other people's libraries, each in a file peers_*.cc that is built where its package is
// installed (bench/CMakeLists.txt). Each row is measured in processes of its own.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "bench.h"
#include "graph.h"

namespace xauto::bench {

struct Peer {
  std::string name;
  std::string dispatch_name;  ///< ... of its rows there
  /// From the trigger until the last node has run, seen by the triggering thread.
  Samples (*dispatch)(const Options& options, const Dag& dag) = nullptr;
  /// 64 bytes to another process and back, both asleep in between.
  Samples (*round_trip)(const Options& options, int here, int there) = nullptr;
  /// One message to another process, as in transfer.cc.
  Samples (*transfer)(const Options& options, std::size_t bytes, std::uint64_t rounds) = nullptr;
};

/// Those that were built in.
[[nodiscard]] const std::vector<Peer>& peers();

/// A row, unless the measurement failed (which says why itself).
void add_peer(Table& table, const std::string& section, const std::string& name,
              const std::string& program, const std::function<Samples()>& measure,
              double divide = 1);

// peers_starpu.cc
Samples starpu_dispatch(const Options& options, const Dag& dag);
// peers_cyclone.cc
Samples cyclone_dispatch(const Options& options, const Dag& dag);
Samples cyclone_round_trip(const Options& options, int here, int there);
Samples cyclone_transfer(const Options& options, std::size_t bytes, std::uint64_t rounds);
/// ... of a sensor_msgs/Image with so many bytes of pixels: Cyclone's own type, and ours.
Samples cyclone_image(const Options& options, std::size_t bytes, std::uint64_t rounds);
Samples native_image(const Options& options, std::size_t bytes, std::uint64_t rounds);
// peers_iceoryx.cc
Samples iceoryx_dispatch(const Options& options, const Dag& dag);
Samples iceoryx_round_trip(const Options& options, int here, int there);
Samples iceoryx_transfer(const Options& options, std::size_t bytes, std::uint64_t rounds);

}  // namespace xauto::bench
