// SPDX-License-Identifier: Apache-2.0
// Writing to what we were started with (stderr), whoever may or may not read it. A coordinator that
// stood in write(2), because a pipe is full or a terminal is stopped, would stop the run.
#pragma once

#include <cstddef>
#include <string_view>

namespace xauto {

/// Writes what is taken at once, and returns how many bytes that were. Raises no SIGPIPE.
///
/// O_NONBLOCK is a flag of the open file, which our shell and our children have as well: it is not
/// touched. A pipe or a terminal is opened once more for each call, sockets have a flag for one
/// call. What we may not open is another user's: into a pipe goes a page that the kernel moves, and
/// a terminal is asked before. Files and devices are written to: a disk does not wait for a reader.
std::size_t write_now(int fd, std::string_view text);

}  // namespace xauto
