// SPDX-License-Identifier: Apache-2.0
#include "peers.h"

#include "pair.h"

namespace xauto::bench {

const std::vector<Peer>& peers() {
  static const std::vector<Peer> all = {
#ifdef XAUTO_BENCH_STARPU
      {"starpu", "starpu, 2 cores", starpu_dispatch, nullptr, nullptr},
#endif
#ifdef XAUTO_BENCH_ICEORYX
      {"iceoryx", "iceoryx-waitset", iceoryx_dispatch, iceoryx_round_trip, iceoryx_transfer},
#endif
#ifdef XAUTO_BENCH_CYCLONE
      {"cyclone-udp", "cyclone-waitset", cyclone_dispatch, cyclone_round_trip, cyclone_transfer},
#endif
  };
  return all;
}

void add_peer(Table& table, const std::string& section, const std::string& name,
              const std::string& program, const std::function<Samples()>& measure, double divide) {
  Samples samples = in_process(program + ", " + name, measure);
  if (samples.count() > 0) table.add(section, name, program, samples, divide);
}

}  // namespace xauto::bench
