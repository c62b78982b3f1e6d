// SPDX-License-Identifier: Apache-2.0
#include "story/perfetto.h"

#include <algorithm>

#include "base/clock.h"
#include "story/perfetto.pb.h"

namespace xauto::story {
namespace {

namespace proto = ::xauto::perfetto;

/// One writer, one sequence: any number but 0.
constexpr std::uint32_t kIncrementalStateCleared = 1;

/// A Trace is packets one after the other, so that we need never hold two of them.
void append(std::string& file, const proto::TracePacket& packet) {
  const std::size_t bytes = packet.ByteSizeLong();
  file.push_back(0x0a);  // field 1 (packet), length-delimited
  for (std::size_t left = bytes;; left >>= 7) {
    const auto low = static_cast<char>(left & 0x7f);
    if (left < 0x80) {
      file.push_back(low);
      break;
    }
    file.push_back(static_cast<char>(low | static_cast<char>(0x80)));
  }
  packet.AppendToString(&file);
}

/// Strings of the format are UTF-8 by its rules; names from outside are shown byte for byte where
/// they are, and with '?' where they are not.
std::string utf8(const std::string& text) {
  std::string out;
  out.reserve(text.size());
  for (std::size_t i = 0; i < text.size();) {
    const auto c = static_cast<unsigned char>(text[i]);
    const std::size_t length = c < 0x80                ? 1
                               : c >= 0xc2 && c < 0xe0 ? 2
                               : c >= 0xe0 && c < 0xf0 ? 3
                               : c >= 0xf0 && c < 0xf5 ? 4
                                                       : 0;
    bool good = length > 0 && i + length <= text.size();
    for (std::size_t k = 1; good && k < length; ++k)
      good = (static_cast<unsigned char>(text[i + k]) & 0xc0) == 0x80;
    if (good)
      out.append(text, i, length);
    else
      out.push_back('?');
    i += good ? length : 1;
  }
  return out;
}

}  // namespace

PerfettoWriter::Track PerfettoWriter::add_track(Track parent, const std::string& name,
                                                const std::string& description) {
  tracks_.push_back({parent, name, description, false});
  return tracks_.size();
}

PerfettoWriter::Track PerfettoWriter::add_counter(Track parent, const std::string& name) {
  tracks_.push_back({parent, name, {}, true});
  return tracks_.size();
}

/// Names repeat thousands of times; there are a few dozen of them.
std::uint32_t PerfettoWriter::name_of(const std::string& name) {
  const auto [at, added] = name_index_.try_emplace(name, static_cast<std::uint32_t>(names_.size()));
  if (added) names_.push_back(utf8(name));
  return at->second;
}

void PerfettoWriter::add(Track track, std::int64_t ts_ns, Kind kind, const std::string& name,
                         Details details) {
  events_.push_back(
      {ts_ns, track, kind, name_of(name), 0, static_cast<std::int32_t>(details_.size())});
  details_.push_back(std::move(details));
}

void PerfettoWriter::begin(Track track, std::int64_t ts_ns, const std::string& name,
                           Details details) {
  add(track, ts_ns, Kind::kBegin, name, std::move(details));
}

void PerfettoWriter::end(Track track, std::int64_t ts_ns) {
  events_.push_back({ts_ns, track, Kind::kEnd, 0, 0, -1});
}

void PerfettoWriter::instant(Track track, std::int64_t ts_ns, const std::string& name,
                             Details details) {
  add(track, ts_ns, Kind::kInstant, name, std::move(details));
}

void PerfettoWriter::count(Track track, std::int64_t ts_ns, std::int64_t value) {
  events_.push_back({ts_ns, track, Kind::kCount, 0, value, -1});
}

std::string PerfettoWriter::write(std::int64_t clock_offset_ns) const {
  std::string file;
  const std::uint64_t base = std::uint64_t{sequence_ - 1} << 32;
  bool first = true;
  for (std::size_t t = 0; t < tracks_.size(); ++t) {
    proto::TracePacket packet;
    packet.set_trusted_packet_sequence_id(sequence_);
    if (first) {
      packet.set_first_packet_on_sequence(true);
      packet.set_sequence_flags(kIncrementalStateCleared);
      if (lossy_) packet.set_previous_packet_dropped(1);
      first = false;
    }
    proto::TrackDescriptor& track = *packet.mutable_track_descriptor();
    track.set_uuid(base + t + 1);
    track.set_name(utf8(tracks_[t].name));
    if (tracks_[t].parent != kNoParent) track.set_parent_uuid(base + tracks_[t].parent);
    if (!tracks_[t].description.empty()) track.set_description(utf8(tracks_[t].description));
    track.set_sibling_order_rank(static_cast<std::int32_t>(t));
    if (tracks_[t].counter)
      track.mutable_counter()->set_unit(proto::CounterDescriptor::UNIT_COUNT);
    else
      track.set_child_ordering(proto::TrackDescriptor::EXPLICIT);
    append(file, packet);
  }

  std::vector<std::uint32_t> order(events_.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = static_cast<std::uint32_t>(i);
  std::stable_sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) {
    return events_[a].ts_ns < events_[b].ts_ns;
  });
  for (const std::uint32_t i : order) {
    const Event& event = events_[i];
    proto::TracePacket packet;
    packet.set_timestamp(
        static_cast<std::uint64_t>(std::max<std::int64_t>(0, event.ts_ns + clock_offset_ns)));
    packet.set_trusted_packet_sequence_id(sequence_);
    proto::TrackEvent& out = *packet.mutable_track_event();
    out.set_track_uuid(base + event.track);
    switch (event.kind) {
      case Kind::kBegin:
        out.set_type(proto::TrackEvent::TYPE_SLICE_BEGIN);
        break;
      case Kind::kEnd:
        out.set_type(proto::TrackEvent::TYPE_SLICE_END);
        break;
      case Kind::kInstant:
        out.set_type(proto::TrackEvent::TYPE_INSTANT);
        break;
      case Kind::kCount:
        out.set_type(proto::TrackEvent::TYPE_COUNTER);
        out.set_counter_value(event.value);
        break;
    }
    if (event.details >= 0) {
      const Details& details = details_[static_cast<std::size_t>(event.details)];
      out.set_name(names_[event.name]);
      if (!details.category.empty()) out.add_categories(utf8(details.category));
      for (const auto& [name, value] : details.args) {
        proto::DebugAnnotation& arg = *out.add_debug_annotations();
        arg.set_name(utf8(name));
        if (const auto* number = std::get_if<std::int64_t>(&value))
          arg.set_int_value(*number);
        else
          arg.set_string_value(utf8(std::get<std::string>(value)));
      }
      for (const std::uint64_t flow : details.flows_out) out.add_flow_ids(base + flow);
      for (const std::uint64_t flow : details.flows_in) out.add_terminating_flow_ids(base + flow);
      for (const std::uint64_t flow : details.across_out) out.add_flow_ids(flow);
      for (const std::uint64_t flow : details.across_in) out.add_terminating_flow_ids(flow);
    }
    append(file, packet);
  }
  return file;
}

std::int64_t boottime_offset_ns() {
  return clock_ns(CLOCK_BOOTTIME) - now_ns();
}

}  // namespace xauto::story
