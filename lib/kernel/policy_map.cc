// SPDX-License-Identifier: Apache-2.0
#include "kernel/policy_map.h"

#include <cerrno>
#include <cstddef>
#include <cstring>

#include <linux/bpf.h>
#include <linux/btf.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "kernel/run_folder.h"

namespace xauto::kernel {
namespace {

using Row = xauto_bpf_policy;
constexpr const char* kName = "policy";

/// The description of one C struct in BTF (the kernel's Documentation/bpf/btf.rst).
class Btf {
 public:
  std::uint32_t integer(const char* name, std::uint32_t bytes, std::uint32_t encoding) {
    type(name, BTF_KIND_INT, 0, bytes);
    types_.push_back(encoding << 24 | bytes * 8);
    return ++last_;
  }
  std::uint32_t array(std::uint32_t of, std::uint32_t index, std::uint32_t elements) {
    type("", BTF_KIND_ARRAY, 0, 0);
    types_.insert(types_.end(), {of, index, elements});
    return ++last_;
  }
  struct Member {
    const char* name;
    std::uint32_t type;
    std::size_t offset;
  };
  std::uint32_t structure(const char* name, std::size_t bytes, const std::vector<Member>& members) {
    type(name, BTF_KIND_STRUCT, members.size(), bytes);
    for (const Member& m : members)
      types_.insert(types_.end(), {text(m.name), m.type, static_cast<std::uint32_t>(m.offset * 8)});
    return ++last_;
  }
  /// Given to the kernel.
  [[nodiscard]] UniqueFd load() const {
    const auto bytes = static_cast<__u32>(types_.size() * sizeof types_.front());
    const btf_header header{.magic = BTF_MAGIC,
                            .version = BTF_VERSION,
                            .flags = 0,
                            .hdr_len = sizeof(btf_header),
                            .type_off = 0,
                            .type_len = bytes,
                            .str_off = bytes,
                            .str_len = static_cast<__u32>(texts_.size())};
    std::string blob(reinterpret_cast<const char*>(&header), sizeof header);
    blob.append(reinterpret_cast<const char*>(types_.data()), bytes).append(texts_);
    bpf_attr attributes{};
    attributes.btf = reinterpret_cast<std::uint64_t>(blob.data());
    attributes.btf_size = static_cast<__u32>(blob.size());
    return UniqueFd(
        static_cast<int>(syscall(SYS_bpf, BPF_BTF_LOAD, &attributes, sizeof attributes)));
  }

 private:
  std::uint32_t text(const char* name) {
    if (*name == '\0') return 0;
    const auto at = static_cast<std::uint32_t>(texts_.size());
    texts_.append(name).push_back('\0');
    return at;
  }
  void type(const char* name, std::uint32_t kind, std::size_t members, std::size_t bytes) {
    types_.insert(types_.end(), {text(name), kind << 24 | static_cast<std::uint32_t>(members),
                                 static_cast<std::uint32_t>(bytes)});
  }
  std::vector<std::uint32_t> types_;
  std::string texts_ = std::string(1, '\0');
  std::uint32_t last_ = 0;  ///< types are numbered from 1 on
};

Error denied_or(const std::string& what) {
  const bool denied = errno == EPERM || errno == EACCES;
  return {denied ? ErrorCode::kPermission : ErrorCode::kUnavailable,
          what + ": " + strerror(errno),
          {},
          denied ? bpf_hint() : ""};
}

Result<UniqueFd> make_map(std::size_t rows) {
  Btf btf;
  const std::uint32_t character = btf.integer("char", 1, BTF_INT_SIGNED);
  const std::uint32_t number = btf.integer("unsigned int", 4, 0);
  const std::uint32_t wide = btf.integer("long long", 8, BTF_INT_SIGNED);
  const std::uint32_t xnode = btf.array(character, number, sizeof(Row::xnode));
  const std::uint32_t xpu = btf.array(character, number, sizeof(Row::xpu));
  const std::uint32_t by = btf.array(character, number, sizeof(Row::by));
  const std::uint32_t row = btf.structure("xauto_bpf_policy", sizeof(Row),
                                          {{"xnode", xnode, offsetof(Row, xnode)},
                                           {"xpu", xpu, offsetof(Row, xpu)},
                                           {"by", by, offsetof(Row, by)},
                                           {"keys", number, offsetof(Row, keys)},
                                           {"value", wide, offsetof(Row, value)},
                                           {"xpu_index", number, offsetof(Row, xpu_index)},
                                           {"table", number, offsetof(Row, table)}});
  const UniqueFd types = btf.load();
  if (!types) return tl::unexpected<Error>(denied_or("describing the policy's BPF map"));
  bpf_attr attributes{};
  attributes.map_type = BPF_MAP_TYPE_ARRAY;
  attributes.key_size = sizeof(std::uint32_t);
  attributes.value_size = sizeof(Row);
  attributes.max_entries = static_cast<__u32>(rows);
  attributes.map_flags = BPF_F_MMAPABLE;
  std::strcpy(attributes.map_name, XAUTO_BPF_POLICY);
  attributes.btf_fd = static_cast<__u32>(types.get());
  attributes.btf_key_type_id = number;
  attributes.btf_value_type_id = row;
  UniqueFd fd(static_cast<int>(syscall(SYS_bpf, BPF_MAP_CREATE, &attributes, sizeof attributes)));
  if (!fd) return tl::unexpected<Error>(denied_or("making the policy's BPF map"));
  return fd;
}

}  // namespace

Result<PolicyMap> PolicyMap::create(const std::vector<Row>& rows) {
  if (rows.empty() || rows.size() > XAUTO_BPF_MAX_XNODES)
    return fail(ErrorCode::kInvalid, std::to_string(rows.size()) +
                                         " XNodes; the BPF map holds 1 to " +
                                         std::to_string(XAUTO_BPF_MAX_XNODES));
  PolicyMap made;
  XAUTO_ASSIGN(made.fd_, make_map(rows.size()));
  XAUTO_ASSIGN(made.map_, MappedMap::map(made.fd_.get(), sizeof(Row), true));
  XAUTO_TRY(made.put(rows));
  return made;
}

Result<PolicyMap> PolicyMap::open(const std::string& run) {
  XAUTO_TRY(RunFolder::check_name(run));
  PolicyMap there;
  XAUTO_ASSIGN(there.fd_, open_pinned_map(RunFolder::path_of(run) + "/" + kName));
  XAUTO_TRY(check_shape(there.fd_.get(), kName, sizeof(Row), 1));
  XAUTO_ASSIGN(there.map_, MappedMap::map(there.fd_.get(), sizeof(Row), true));
  return there;
}

Status PolicyMap::pin(const std::string& folder) const {
  return pin_map(fd_.get(), folder + "/" + kName);
}

Status PolicyMap::put(const std::vector<Row>& rows) {
  if (rows.size() != map_.size())
    return fail(ErrorCode::kInvalid, "a policy of " + std::to_string(rows.size()) + " rows for " +
                                         std::to_string(map_.size()));
  std::memcpy(map_.as<Row>(), rows.data(), rows.size() * sizeof(Row));
  return {};
}

std::vector<Row> PolicyMap::rows() const {
  const Row* rows = map_.as<Row>();
  return {rows, rows + map_.size()};
}

}  // namespace xauto::kernel
