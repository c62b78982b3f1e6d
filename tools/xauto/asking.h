// SPDX-License-Identifier: Apache-2.0
// Asking runs: anybody may listen at the name of a run's socket, say nothing, leave its queue full, or say
// what a terminal would obey. So all are asked at once and have one limit together, the kernel says who
// listens, and what they say is text.
#pragma once

#include <string>
#include <vector>

#include <xauto/result.h>

#include "base/unique_fd.h"
#include "model/json_value.h"

namespace xauto::cli {

/// A parsed address (processes/address.h), of this network namespace.
struct RunSocket {
  std::string address, run, name;
  int pid = 0;  ///< as the run calls itself
};
/// Those that listen. Names that no run has are left out.
[[nodiscard]] std::vector<RunSocket> run_sockets();

/// Our own user's listen where they like. Of others root alone is answered; who listens must be the
/// process whose pid is in the run's name, now.
struct Host {
  unsigned uid = 0;
  UniqueFd socket;
};
/// [i] of `sockets`[i], within `limit_ms`. kPermission: it is not for us.
[[nodiscard]] std::vector<Result<Host>> reach(const std::vector<RunSocket>& sockets, int limit_ms);

struct Answer {
  unsigned uid = 0;
  Json said;  ///< an object, without what a terminal obeys
  std::vector<UniqueFd> fds;
};
/// One packet from each, [i] of `sockets`[i]. `question`: sent before; empty: they answer unasked.
/// `lines`: of a text that may have several they stay.
[[nodiscard]] std::vector<Result<Answer>> ask(const std::vector<RunSocket>& sockets,
                                              const std::string& question, int limit_ms,
                                              bool lines = false);

/// For people: the name, or "uid 1000" where it has none.
[[nodiscard]] std::string user_name(unsigned uid);

}  // namespace xauto::cli
