// SPDX-License-Identifier: Apache-2.0
// Who has a real XPU: each run holds the name of a socket per real XPU, which takes nobody in, so that all users and runs
// of this machine see it in /proc/net/unix. A claim takes for granted that each XPU serves one app alone.
// Other network namespaces are not seen. Anybody can hold such a name: who is named may be a liar.
#pragma once

#include <string>
#include <vector>

#include "session/session.h"

namespace xauto::runtime {

/// Abstract sockets of runs: PREFIX<run>/<secret>/<name>.
inline constexpr const char* kSocketPrefix = "xauto/";
inline constexpr const char* kMark = "real:";

/// [XPU] what of the machine it is, "core3", "gpu0"; empty: it is emulated. CPU instance i is the i-th core that
/// this process may use.
[[nodiscard]] std::vector<std::string> hardware_of(const Platform& platform,
                                                   const std::vector<Presence>& presence);
/// Names of the sockets that say so, each once.
[[nodiscard]] std::vector<std::string> marks_of(const Session& session);

struct Holder {
  std::string hardware, run, uid;           ///< uid: empty, if it is not known
  [[nodiscard]] std::string words() const;  ///< "run 77-0 of uid 1000"
};
/// Of all runs on this machine but those whose addresses begin with `own`, which may be empty.
[[nodiscard]] std::vector<Holder> holders(const std::string& own);
/// PREFIX<run>/<secret>/ of an address.
[[nodiscard]] std::string run_of_address(const std::string& address);

}  // namespace xauto::runtime
