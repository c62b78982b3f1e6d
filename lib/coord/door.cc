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
constexpr int kAnswerMs = 2'000;

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

Result<Json> ask_machine(const std::string& path) {
  XAUTO_ASSIGN(const UniqueFd socket, connect_path(path, kAnswerMs));
  const auto ask = static_cast<std::uint32_t>(MessageKind::kStatus);
  XAUTO_TRY(send_packet(socket.get(), &ask, sizeof ask));
  if (!wait_readable(socket.get(), kAnswerMs))
    return fail(ErrorCode::kTimeout, "did not answer", path);
  std::string text(kMaxStatusBytes, '\0');
  XAUTO_ASSIGN(const std::size_t size, receive_packet(socket.get(), text.data(), text.size()));
  text.resize(size);
  auto told = Json::parse(text);
  if (!told) return fail(ErrorCode::kUnavailable, "answered with something else than JSON", path);
  return *std::move(told);
}

Neighbours neighbours(const Json& machine) {
  Neighbours of;
  for (const Json& app : machine.at("apps").elements())
    for (const Json& pid : app.at("pids").elements())
      of.processes.push_back(static_cast<pid_t>(pid.integer().value_or(0)));
  for (const Json& coordinator : machine.at("coordinators").elements()) {
    of.processes.push_back(static_cast<pid_t>(coordinator.at("pid").integer().value_or(0)));
    if (const auto off = coordinator.at("foreign").at("not_kept_off").integer())
      of.not_kept_off[coordinator.at("xpu").text().value_or("?")] = *off;
  }
  return of;
}

}  // namespace xauto::coord
