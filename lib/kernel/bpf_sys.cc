// SPDX-License-Identifier: Apache-2.0
#include "kernel/bpf_sys.h"

#include <cerrno>
#include <cstring>
#include <utility>

#include <linux/bpf.h>
#include <linux/magic.h>
#include <sys/mman.h>
#include <sys/mount.h>
#include <sys/syscall.h>
#include <sys/vfs.h>
#include <unistd.h>

#include "base/first_line.h"

namespace xauto::kernel {
namespace {

constexpr const char* kBpffs = "/sys/fs/bpf";

long bpf(int command, bpf_attr& attributes) {
  return syscall(SYS_bpf, command, &attributes, sizeof attributes);
}

std::uint64_t word(const void* pointer) {
  return reinterpret_cast<std::uint64_t>(pointer);
}

Status refused(const std::string& what) {
  const int error = errno;
  const bool denied = error == EPERM || error == EACCES;
  return fail(denied            ? ErrorCode::kPermission
              : error == ENOENT ? ErrorCode::kNotFound
                                : ErrorCode::kIo,
              what + ": " + strerror(error), {}, denied ? bpf_hint() : "");
}

}  // namespace

std::string bpf_hint() {
  return "BPF needs root, or CAP_BPF, CAP_PERFMON and CAP_SYS_NICE; a container also needs the "
         "host's /sys/fs/bpf, or CAP_SYS_ADMIN to mount one";
}

bool may_use_bpf() {
  bpf_attr attributes{};
  attributes.map_type = BPF_MAP_TYPE_HASH;  // an array is allowed to everybody on some kernels
  attributes.key_size = attributes.value_size = 4;
  attributes.max_entries = 1;
  const UniqueFd fd(static_cast<int>(bpf(BPF_MAP_CREATE, attributes)));
  // Making a map may be open to all; pinning it for others is not.
  return static_cast<bool>(fd) && geteuid() == 0;
}

bool has_bpf() {
  bpf_attr attributes{};
  return bpf(BPF_MAP_CREATE, attributes) >= 0 || errno != ENOSYS;  // EINVAL, or EPERM
}

Result<UniqueFd> open_pinned_map(const std::string& path) {
  bpf_attr attributes{};
  attributes.pathname = word(path.c_str());
  UniqueFd fd(static_cast<int>(bpf(BPF_OBJ_GET, attributes)));
  if (fd.get() < 0) return tl::unexpected<Error>(refused("pinned map '" + path + "'").error());
  return fd;
}

Status pin_map(int map_fd, const std::string& path) {
  unlink(path.c_str());
  bpf_attr attributes{};
  attributes.pathname = word(path.c_str());
  attributes.bpf_fd = static_cast<__u32>(map_fd);
  if (bpf(BPF_OBJ_PIN, attributes) != 0) return refused("pinning " + path);
  return {};
}

Result<MapShape> shape_of(int map_fd) {
  bpf_map_info info{};
  bpf_attr attributes{};
  attributes.info.bpf_fd = static_cast<__u32>(map_fd);
  attributes.info.info_len = sizeof info;
  attributes.info.info = word(&info);
  if (bpf(BPF_OBJ_GET_INFO_BY_FD, attributes) != 0)
    return tl::unexpected<Error>(refused("not a BPF map").error());
  return MapShape{info.key_size, info.value_size, info.max_entries, info.map_flags};
}

Status check_shape(int map_fd, const std::string& name, std::size_t value_size,
                   std::uint32_t at_least, std::size_t key_size) {
  XAUTO_ASSIGN(const MapShape shape, shape_of(map_fd));
  if (shape.key_size == key_size && shape.value_size == value_size && shape.max_entries >= at_least)
    return {};
  return fail(ErrorCode::kInvalid,
              "map '" + name + "' has keys of " + std::to_string(shape.key_size) +
                  " and values of " + std::to_string(shape.value_size) + " bytes, " +
                  std::to_string(shape.max_entries) + " of them; this program needs " +
                  std::to_string(key_size) + ", " + std::to_string(value_size) + ", and " +
                  std::to_string(at_least),
              {}, "the maps were made by another version of XAuto: use one version for all");
}

Status set_element(int map_fd, const void* key, const void* value) {
  bpf_attr attributes{};
  attributes.map_fd = static_cast<__u32>(map_fd);
  attributes.key = word(key);
  attributes.value = word(value);
  attributes.flags = BPF_ANY;
  if (bpf(BPF_MAP_UPDATE_ELEM, attributes) != 0) return refused("writing into a BPF map");
  return {};
}

Status get_element(int map_fd, const void* key, void* value) {
  bpf_attr attributes{};
  attributes.map_fd = static_cast<__u32>(map_fd);
  attributes.key = word(key);
  attributes.value = word(value);
  if (bpf(BPF_MAP_LOOKUP_ELEM, attributes) != 0) return refused("reading from a BPF map");
  return {};
}

Result<std::size_t> possible_cpus(const std::string& root) {
  const std::string path = root + "/sys/devices/system/cpu/possible";
  const std::string list = first_line(path);
  // "0-3" or "0,2-5": the last number is the greatest.
  const std::size_t last = list.find_last_not_of("0123456789");
  const std::string number = last == std::string::npos ? list : list.substr(last + 1);
  if (number.empty() || number.size() > 5)
    return fail(ErrorCode::kIo, "'" + list + "' is no list of CPUs", path);
  return std::stoul(number) + 1;
}

void remove_element(int map_fd, const void* key) {
  bpf_attr attributes{};
  attributes.map_fd = static_cast<__u32>(map_fd);
  attributes.key = word(key);
  (void)bpf(BPF_MAP_DELETE_ELEM, attributes);
}

MappedMap::MappedMap(MappedMap&& other) noexcept
    : address_(std::exchange(other.address_, nullptr)),
      bytes_(other.bytes_),
      elements_(other.elements_) {}

MappedMap& MappedMap::operator=(MappedMap&& other) noexcept {
  std::swap(address_, other.address_);
  std::swap(bytes_, other.bytes_);
  std::swap(elements_, other.elements_);
  return *this;
}

MappedMap::~MappedMap() {
  if (address_ != nullptr) munmap(address_, bytes_);
}

Result<MappedMap> MappedMap::map(int map_fd, std::size_t value_size, bool writable) {
  XAUTO_ASSIGN(const MapShape shape, shape_of(map_fd));
  if (shape.value_size != value_size || value_size % 8 != 0 || (shape.flags & BPF_F_MMAPABLE) == 0)
    return fail(ErrorCode::kInvalid,
                "is not a mappable BPF map of " + std::to_string(value_size) + " byte values");
  const auto page = static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
  MappedMap mapped;
  mapped.elements_ = shape.max_entries;
  mapped.bytes_ = (std::size_t{shape.max_entries} * value_size + page - 1) / page * page;
  void* address =
      mmap(nullptr, mapped.bytes_, PROT_READ | (writable ? PROT_WRITE : 0), MAP_SHARED, map_fd, 0);
  if (address == MAP_FAILED)
    return tl::unexpected<Error>(refused("mapping a BPF map into memory").error());
  mapped.address_ = address;
  return mapped;
}

Status mount_bpffs() {
  struct statfs status {};
  if (statfs(kBpffs, &status) == 0 && status.f_type == BPF_FS_MAGIC) return {};
  if (mount("bpf", kBpffs, "bpf", 0, "mode=0700") != 0)
    return refused(std::string("mounting the BPF file system at ") + kBpffs);
  return {};
}

}  // namespace xauto::kernel
