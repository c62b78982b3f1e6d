// SPDX-License-Identifier: Apache-2.0
#include "launch/meeting_table.h"

#include <algorithm>

#include <fmt/format.h>

namespace xauto::launch {
namespace {

std::string text_of(const Json& message, const char* name) {
  return message.at(name).text().value_or("");
}

Json refused(const std::string& why) {
  return {{"is", "refused"}, {"why", why}};
}

}  // namespace

std::vector<std::byte> frame_of(const Json& message) {
  const std::string text = message.dump();
  std::vector<std::byte> frame(4 + text.size());
  for (std::size_t i = 0; i < 4; ++i)
    frame[i] = static_cast<std::byte>(text.size() >> (8 * i) & 255U);
  std::transform(text.begin(), text.end(), frame.begin() + 4,
                 [](char c) { return static_cast<std::byte>(c); });
  return frame;
}

std::optional<Json> FrameReader::next(std::size_t most) {
  if (bad_ || bytes_.size() < 4) return std::nullopt;
  std::size_t length = 0;
  for (std::size_t i = 0; i < 4; ++i) length |= std::to_integer<std::size_t>(bytes_[i]) << (8 * i);
  if (length > most) {
    bad_ = true;
    return std::nullopt;
  }
  if (bytes_.size() - 4 < length) return std::nullopt;
  std::string text(length, '\0');
  for (std::size_t i = 0; i < length; ++i) text[i] = static_cast<char>(bytes_[4 + i]);
  bytes_.erase(bytes_.begin(), bytes_.begin() + static_cast<std::ptrdiff_t>(4 + length));
  auto message = Json::parse(text);
  bad_ = !message || !message->is_object() || !message->at("is").text();
  return bad_ ? std::nullopt : std::move(message);
}

MeetingTable::MeetingTable(MeetingSetUp set_up, Instant now)
    : set_up_(std::move(set_up)), began_ns_(now.now_ns) {
  for (const std::string& host : set_up_.hosts) parts_[host];
  parts_[set_up_.own.host].stage = PartStage::kThere;
}

MeetingTable::Says MeetingTable::connected(int connection, Instant now) {
  lines_[connection] = {.since_ns = now.now_ns,
                        .heard_ns = now.now_ns,
                        .told_ns = now.now_ns,
                        .clock_ns = now.tai_ns};
  return {{connection, {{"is", "clock"}, {"tai_ns", now.tai_ns}}}};
}

bool MeetingTable::known(int connection) const {
  const auto line = lines_.find(connection);
  return line != lines_.end() && !line->second.host.empty();
}

/// Why this part may not come in; empty: it may.
std::string MeetingTable::refusal(const Json& hello, const Line& line, Instant now) const {
  const std::string host = text_of(hello, "host");
  const auto part = parts_.find(host);
  if (part == parts_.end() || host == set_up_.own.host)
    return "'" + host + "' is no other host of the platform";
  if (text_of(hello, "hash") != set_up_.own.hash)
    return "'" + host +
           "' has another app, platform, policy, version of XAuto, kind of CPU, or number of "
           "releases than '" +
           set_up_.own.host + "': give all parts the same files and flags";
  if (part->second.stage != PartStage::kAway) return "a part of '" + host + "' is there already";
  if (hello.at("tai_offset_s").integer() != set_up_.own.tai_offset_s)
    return fmt::format(
        "the kernel of '{}' has another offset of TAI than that of '{}', {} s: chrony (leapsectz), "
        "or "
        "phc2sys and ptp4l, set it",
        host, set_up_.own.host, set_up_.own.tai_offset_s);
  const auto tai = hello.at("tai_ns").integer();
  if (hello.at("clock_ns").integer() != line.clock_ns || !tai) return "it did not say its time";
  // It read its clock between our two looks.
  const __int128 twice = __int128{2} * *tai - line.clock_ns - now.tai_ns;
  const __int128 apart = (twice < 0 ? -twice : twice) - (now.tai_ns - line.clock_ns);
  if (apart / 2 > set_up_.most_apart_ns)
    return fmt::format(
        "the clocks of '{}' and '{}' are at least {:.3f} ms apart, and no message may take so "
        "long: discipline them (docs/several-machines.md)",
        host, set_up_.own.host, static_cast<double>(apart) / 2e6);
  const std::uint64_t run = static_cast<std::uint64_t>(hello.at("run").integer().value_or(0));
  if (run != 0 && run_ != 0 && run != run_) return "'" + host + "' runs already, in another run";
  return {};
}

void MeetingTable::welcome(int connection, Says& says) const {
  says.push_back({connection, {{"is", "welcome"}, {"run", run_}, {"start_tai_ns", start_tai_ns_}}});
}

void MeetingTable::hello(int connection, const Json& message, Instant now, Says& says) {
  Line& line = lines_[connection];
  if (const std::string why = refusal(message, line, now); !why.empty()) {
    news_.push_back("a part was refused: " + why);
    says.push_back({connection, refused(why), true});
    lines_.erase(connection);
    return;
  }
  line.host = text_of(message, "host");
  Part& part = parts_[line.host];
  part = {PartStage::kThere, connection};
  const auto run = message.at("run").integer().value_or(0);
  const auto start = message.at("start_tai_ns").integer().value_or(0);
  // It goes on, and we were started again.
  if (run > 0 && start > 0 && run_ == 0) {
    run_ = static_cast<std::uint64_t>(run);
    start_tai_ns_ = start;
    for (const auto& [host, other] : parts_)
      if (other.connection >= 0 && other.connection != connection) welcome(other.connection, says);
  }
  if (start_tai_ns_ != 0) news_.push_back("part '" + line.host + "' has joined");
  if (run_ != 0) welcome(connection, says);
}

MeetingTable::Says MeetingTable::hear(int connection, const Json& message, Instant now) {
  Says says;
  const auto line = lines_.find(connection);
  if (line == lines_.end()) return says;
  line->second.heard_ns = now.now_ns;
  const std::string is = text_of(message, "is");
  if (line->second.host.empty()) {
    if (is != "hello") return gone(connection, now);
    hello(connection, message, now, says);
  } else if (is == "ready") {
    Part& part = parts_[line->second.host];
    const PartStage stage =
        message.at("met").boolean().value_or(false) ? PartStage::kReady : PartStage::kBuilt;
    if (part.stage != PartStage::kReported) part.stage = stage;
  } else if (is == "report") {
    parts_[line->second.host].stage = PartStage::kReported;
    reports_[line->second.host] = text_of(message, "text");
    says.push_back({connection, {{"is", "thanks"}}});
  }
  come_together(now, says);
  return says;
}

MeetingTable::Says MeetingTable::gone(int connection, Instant) {
  Says says;
  const auto line = lines_.find(connection);
  if (line == lines_.end()) return says;
  const std::string host = line->second.host;
  lines_.erase(line);
  says.push_back({connection, refused("it said what no part says, or nothing"), true});
  if (host.empty()) return says;
  Part& part = parts_[host];
  const bool reported = part.stage == PartStage::kReported;
  part = {reported ? PartStage::kReported : PartStage::kAway, -1};
  if (reported) return says;
  news_.push_back("part '" + host + "' has gone" +
                  (start_tai_ns_ != 0 ? ": what it sends is lost until it is started again" : ""));
  if (start_tai_ns_ == 0) return says;
  ++deaths_[host];
  for (const auto& [name, other] : parts_)
    if (other.connection >= 0) says.push_back({other.connection, {{"is", "gone"}, {"host", host}}});
  return says;
}

MeetingTable::Says MeetingTable::own(PartStage stage, Instant now) {
  Says says;
  parts_[set_up_.own.host].stage = stage;
  come_together(now, says);
  return says;
}

/// Those that are not as far.
std::string MeetingTable::those_before(PartStage stage) const {
  std::string names;
  for (const auto& [host, part] : parts_)
    if (part.stage < stage) names += (names.empty() ? "'" : ", '") + host + "'";
  return names;
}

/// All are there: which run; all are ready: when it starts.
void MeetingTable::come_together(Instant now, Says& says) {
  if (run_ == 0 && those_before(PartStage::kThere).empty()) {
    run_ = set_up_.fresh_run;
    for (const auto& [host, part] : parts_)
      if (part.connection >= 0) welcome(part.connection, says);
  }
  if (run_ == 0 || start_tai_ns_ != 0 || !those_before(PartStage::kReady).empty()) return;
  start_tai_ns_ = now.tai_ns + kStartLeadNs;
  for (const auto& [host, part] : parts_)
    if (part.connection >= 0)
      says.push_back({part.connection, {{"is", "start"}, {"start_tai_ns", start_tai_ns_}}});
}

void MeetingTable::give_up(const std::string& what, Says& says) {
  for (const auto& [host, part] : parts_)
    if (part.connection >= 0) says.push_back({part.connection, refused(what), true});
}

MeetingTable::Says MeetingTable::tick(Instant now) {
  Says says;
  std::vector<int> silent;
  for (auto& [connection, line] : lines_) {
    const std::int64_t limit_ns = line.host.empty() ? kStrangerNs : kPartSilenceNs;
    if (now.now_ns - line.heard_ns > limit_ns) silent.push_back(connection);
    if (line.host.empty() || now.now_ns - line.told_ns < kAliveNs) continue;
    line.told_ns = now.now_ns;
    says.push_back({connection, {{"is", "alive"}}});
  }
  for (const int connection : silent)
    for (Say& say : gone(connection, now)) says.push_back(std::move(say));
  if (error_ || start_tai_ns_ != 0 || now.now_ns - began_ns_ < set_up_.limit_ns) return says;
  const std::string away = those_before(PartStage::kThere),
                    unbuilt = those_before(PartStage::kBuilt),
                    unmet = those_before(PartStage::kReady);
  const double limit_s = static_cast<double>(set_up_.limit_ns) * 1e-9;
  if (!away.empty())
    error_ = {ErrorCode::kTimeout,
              fmt::format("nobody came from host {} within {:g} s", away, limit_s), "--meet",
              "start there: xauto run --part HOST, with the same files and the same --meet"};
  else if (!unbuilt.empty())
    error_ = {ErrorCode::kTimeout,
              fmt::format("the app did not begin within {:g} s on host {}", limit_s, unbuilt),
              "--meet", "an init takes long: give all parts a longer --meet-limit"};
  else
    error_ = {
        ErrorCode::kTimeout,
        fmt::format("DDS did not find the other parts within {:g} s on host {}", limit_s, unmet),
        "--meet",
        "all need the same ROS_DOMAIN_ID, and multicast between them, or CYCLONEDDS_URI with "
        "peers"};
  give_up(error_->what, says);
  return says;
}

bool MeetingTable::expects_reports() const {
  return std::ranges::any_of(parts_, [this](const auto& part) {
    return part.first != set_up_.own.host && part.second.connection >= 0 &&
           part.second.stage != PartStage::kReported;
  });
}

std::vector<std::string> MeetingTable::take_news() {
  return std::exchange(news_, {});
}

}  // namespace xauto::launch
