// SPDX-License-Identifier: Apache-2.0
// What the users of libbpf share: where its messages go, how its errors become ours, giving an
// object the maps of a run.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include <bpf/bpf.h>
#include <bpf/libbpf.h>

#include <xauto/result.h>

#include "kernel/run_maps.h"

namespace xauto::kernel {

/// While it lives, libbpf's warnings of this process are kept; all of them also go to log::debug.
class LibbpfMessages {
 public:
  LibbpfMessages();
  ~LibbpfMessages();
  /// The first line that says what went wrong, for an error message.
  [[nodiscard]] static std::string said();
};

/// An Error from a negative errno of libbpf, with what libbpf said about it.
[[nodiscard]] tl::unexpected<Error> libbpf_failed(const std::string& what, int error);

/// What the kernel's verifier says of each program of an opened object, if the environment names a
/// file for it: XAUTO_VERIFIER_LOG=FILE, to which is added. Of an accepted program that is its
/// counts. Lives until the object is loaded; not thread-safe, since it sets the object's buffers.
class VerifierLog {
 public:
  explicit VerifierLog(bpf_object* object);
  /// After the loading, whether it went well or not.
  void write() const;

 private:
  const char* path_;
  bpf_object* object_;
  std::vector<std::pair<std::string, std::string>> logs_;  ///< program, what was said of it
};

/// Makes `map` of an opened object the run's map of that name.
[[nodiscard]] Status reuse(bpf_map* map, const RunMaps& maps);

}  // namespace xauto::kernel
