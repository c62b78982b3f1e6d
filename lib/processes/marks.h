// SPDX-License-Identifier: Apache-2.0
// Who has a real XPU: each run holds the name of a socket per real XPU that it uses, which takes nobody in, so that all
// users and runs of this machine see it in /proc/net/unix. A claim takes for granted that each XPU serves one app alone.
// Runs
// that share it under the machine's coordinator do so in their marks, too, and are admitted to each other. Other
// network namespaces are not seen. Anybody can hold such a name: who is named may be a liar.
#pragma once

#include <string>
#include <vector>

#include "session/session.h"

namespace xauto::runtime {

inline constexpr const char* kMark = "real:";

/// What of the machine an XPU of a run is.
struct RealXpu {
  std::string
      hardware;  ///< "core3", "gpu0"; empty: it is emulated, or no XNode of the run is placed there
  int core = -1;  ///< CPU instance i is the i-th core that this process may use; -1: it is none
  bool shared = false;  ///< under the machine's coordinator, which admits who may be there, too
};
/// [XPU] of the session's policy, or all of its tables; without our scheduling any may be used.
[[nodiscard]] std::vector<RealXpu> real_xpus_of(const Session& session);
/// Names of the sockets that say so, each once.
[[nodiscard]] std::vector<std::string> marks_of(const Session& session);

struct Holder {
  std::string hardware, run, uid;           ///< uid: empty, if it is not known
  bool shared = false;                      ///< as above: no stranger to who shares it, too
  [[nodiscard]] std::string words() const;  ///< "run 77-0 of uid 1000"
};
/// Of all runs that are seen from here, but those whose addresses begin with `own`, which may be empty.
[[nodiscard]] std::vector<Holder> holders(const std::string& own);

}  // namespace xauto::runtime
