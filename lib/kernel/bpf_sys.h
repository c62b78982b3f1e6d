// SPDX-License-Identifier: Apache-2.0
// The few calls of bpf(2) that need no libbpf: opening pinned maps, looking at them, mapping them.
// Workers use only this, so that an app does not need libbpf.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include <xauto/result.h>

#include "base/unique_fd.h"

namespace xauto::kernel {

/// The map pinned at `path`.
[[nodiscard]] Result<UniqueFd> open_pinned_map(const std::string& path);

/// In place of what is pinned there.
[[nodiscard]] Status pin_map(int map_fd, const std::string& path);

struct MapShape {
  std::uint32_t key_size = 0, value_size = 0, max_entries = 0, flags = 0;
};
[[nodiscard]] Result<MapShape> shape_of(int map_fd);

/// kInvalid, naming both sizes, if the map is not what this program was built for.
[[nodiscard]] Status check_shape(int map_fd, const std::string& name, std::size_t value_size,
                                 std::uint32_t at_least,
                                 std::size_t key_size = sizeof(std::uint32_t));

[[nodiscard]] Status set_element(int map_fd, const void* key, const void* value);
[[nodiscard]] Status get_element(int map_fd, const void* key, void* value);
/// The greatest number that a CPU can have here, plus one: an element of a per-CPU map has no more
/// values. `root`: "" for this machine, or a folder that stands for / in tests.
[[nodiscard]] Result<std::size_t> possible_cpus(const std::string& root = "");
/// Nothing to do if it is not there.
void remove_element(int map_fd, const void* key);

/// A mmapable array map in our address space.
class MappedMap {
 public:
  MappedMap() = default;
  MappedMap(MappedMap&& other) noexcept;
  MappedMap& operator=(MappedMap&& other) noexcept;
  ~MappedMap();

  /// Maps all elements. `writable` false: reads only.
  [[nodiscard]] static Result<MappedMap> map(int map_fd, std::size_t value_size, bool writable);

  template <class T>
  [[nodiscard]] T* as() const {
    return static_cast<T*>(address_);
  }
  [[nodiscard]] std::uint32_t size() const { return elements_; }
  [[nodiscard]] explicit operator bool() const { return address_ != nullptr; }

 private:
  void* address_ = nullptr;
  std::size_t bytes_ = 0;
  std::uint32_t elements_ = 0;
};

/// Makes sure that a BPF file system is mounted at /sys/fs/bpf, as bpftool does.
[[nodiscard]] Status mount_bpffs();

/// Whether this process may make BPF maps: tries one.
[[nodiscard]] bool may_use_bpf();
/// Whether the kernel has bpf(2): CONFIG_BPF_SYSCALL.
[[nodiscard]] bool has_bpf();
/// One line: which right the kernel wants for BPF.
[[nodiscard]] std::string bpf_hint();

}  // namespace xauto::kernel
