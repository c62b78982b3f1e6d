// SPDX-License-Identifier: Apache-2.0
#include "coord/door.h"

#include <array>
#include <charconv>
#include <cstring>

#include "base/socket.h"

namespace xauto::coord {
namespace {

constexpr char kBetween = '?';
constexpr std::size_t kParts = 6;

template <class T>
bool number(const std::string& text, T& value) {
  const char* end = text.data() + text.size();
  const auto [stopped, error] = std::from_chars(text.data(), end, value);
  return error == std::errc() && stopped == end && !text.empty();
}

}  // namespace

std::string Door::to_text() const {
  if (!shared()) return name;
  std::string text = path;
  for (const std::uint64_t part :
       {std::uint64_t{lease.number}, lease.secret, std::uint64_t{lease.first_xnode},
        std::uint64_t{lease.num_xnodes}})
    text += kBetween + std::to_string(part);
  return text + kBetween + name;
}

Result<Door> parse_door(const std::string& text) {
  if (text.empty() || text.front() != '/') return Door{.path = {}, .name = text, .lease = {}};
  std::array<std::string, kParts> parts;
  std::size_t at = 0;
  for (const char c : text) {
    if (c != kBetween)
      parts[at] += c;
    else if (++at == kParts)
      break;
  }
  Door door{.path = parts[0], .name = parts[5], .lease = {}};
  if (at != kParts - 1 || !number(parts[1], door.lease.number) ||
      !number(parts[2], door.lease.secret) || !number(parts[3], door.lease.first_xnode) ||
      !number(parts[4], door.lease.num_xnodes) || door.name.empty() ||
      door.name.size() >= kMaxHardwareName ||
      door.lease.num_xnodes > UINT32_MAX - door.lease.first_xnode)
    return fail(ErrorCode::kInvalid, "is no address of a coordinator", text);
  return door;
}

Result<UniqueFd> open_door(const Door& door) {
  if (!door.shared()) return connect_abstract(door.name);
  XAUTO_ASSIGN(UniqueFd socket, connect_path(door.path));
  Attach attach{.lease = door.lease.number, .secret = door.lease.secret};
  std::strncpy(attach.hardware, door.name.c_str(), sizeof attach.hardware - 1);
  XAUTO_TRY(send_packet(socket.get(), &attach, sizeof attach));
  return socket;
}

}  // namespace xauto::coord
