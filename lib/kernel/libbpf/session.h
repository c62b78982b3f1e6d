// SPDX-License-Identifier: Apache-2.0
// What the users of libbpf share: where its messages go, how its errors become ours, giving an
// object the maps of a run.
#pragma once

#include <string>

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

/// Makes `map` of an opened object the run's map of that name.
[[nodiscard]] Status reuse(bpf_map* map, const RunMaps& maps);

}  // namespace xauto::kernel
