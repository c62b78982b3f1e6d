// SPDX-License-Identifier: Apache-2.0
// A graph of libbabeltrace2 for each stream, so that a damaged stream costs no other one: its component source.ctf.fs,
// and a sink of ours. Each reads the metadata again, which is short.
#include "import/ctf.h"

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <memory>
#include <optional>
#include <unordered_map>

#include <babeltrace2/babeltrace.h>

namespace xauto::import {
namespace {

namespace fs = std::filesystem;

constexpr int kMaxDepth = 12;
constexpr std::size_t kMaxField = 4096;  ///< bytes of a text
constexpr std::uintmax_t kPage = 4096, kMaxMended = 1u << 30;
constexpr std::size_t kMostCuts = 1024;  ///< pages that a broken packet may have

template <auto put>
struct Put {
  template <class T>
  void operator()(const T* object) const {
    put(object);
  }
};
using Graph = std::unique_ptr<bt_graph, Put<bt_graph_put_ref>>;
using Plugin = std::unique_ptr<const bt_plugin, Put<bt_plugin_put_ref>>;
using Value = std::unique_ptr<bt_value, Put<bt_value_put_ref>>;
using Iterator = std::unique_ptr<bt_message_iterator, Put<bt_message_iterator_put_ref>>;

/// What the library says of its last error, in one line.
std::string cause() {
  const bt_error* error = bt_current_thread_take_error();
  if (error == nullptr) return "libbabeltrace2 says no more";
  std::string text;
  if (bt_error_get_cause_count(error) > 0)
    text = bt_error_cause_get_message(bt_error_borrow_cause_by_index(error, 0));
  bt_error_release(error);
  std::ranges::replace(text, '\n', ' ');
  return text.substr(0, 200);
}

/// Whether metadata are text, or whole packets one behind the other (CTF 1.8, 7.1). The library reads others for ever.
bool whole_metadata(const fs::path& file) {
  constexpr std::uint32_t kMagic = 0x75d11d57;
  constexpr std::streamoff kHeader = 37, kContentBits = 24, kPacketBits = 28;
  std::ifstream in(file, std::ios::binary);
  std::error_code error;
  const auto size = static_cast<std::streamoff>(fs::file_size(file, error));
  const auto number = [&](std::streamoff at) {
    std::uint32_t value = 0;
    in.seekg(at);
    in.read(reinterpret_cast<char*>(&value), sizeof value);
    return value;
  };
  if (error || size < kHeader) return false;
  const std::uint32_t first = number(0);
  if (first != kMagic && first != __builtin_bswap32(kMagic)) {
    char text[] = "/* CTF";
    in.seekg(0);
    in.read(text, sizeof text - 1);
    return in.good() && std::string(text) == "/* CTF";
  }
  const auto bytes = [&](std::streamoff at) {
    const std::uint32_t bits = number(at);
    return static_cast<std::streamoff>((first == kMagic ? bits : __builtin_bswap32(bits)) / 8);
  };
  std::streamoff at = 0;
  while (at + kHeader <= size) {
    const std::streamoff content = bytes(at + kContentBits), packet = bytes(at + kPacketBits);
    if (number(at) != first || content < kHeader || packet < content || packet > size - at)
      return false;
    at += packet;
  }
  return at == size;
}

/// Where events go.
class Collector {
 public:
  Collector(const std::vector<const char*>& providers, const std::vector<WantedEvent>& wanted,
            Trace& trace)
      : wanted_(wanted), trace_(trace) {
    for (const std::string provider : providers)
      for (std::size_t k = 0; k < wanted.size(); ++k)
        kinds_[provider + wanted[k].name] = static_cast<int>(k);
  }

  /// False: there is no room for more.
  bool take(const bt_message* message) {
    std::uint64_t count = 0;
    switch (bt_message_get_type(message)) {
      case BT_MESSAGE_TYPE_EVENT:
        return take_event(message);
      case BT_MESSAGE_TYPE_DISCARDED_EVENTS:
        if (bt_message_discarded_events_get_count(message, &count) ==
            BT_PROPERTY_AVAILABILITY_AVAILABLE)
          trace_.lost_events += count;
        return true;
      case BT_MESSAGE_TYPE_DISCARDED_PACKETS:
        if (bt_message_discarded_packets_get_count(message, &count) ==
            BT_PROPERTY_AVAILABILITY_AVAILABLE)
          trace_.lost_packets += count;
        return true;
      default:
        return true;
    }
  }

 private:
  bool take_event(const bt_message* message) {
    const bt_event* event = bt_message_event_borrow_event_const(message);
    const char* name = bt_event_class_get_name(bt_event_borrow_class_const(event));
    const auto kind = name == nullptr ? kinds_.end() : kinds_.find(name);
    if (kind == kinds_.end()) {
      const std::string other = name == nullptr ? "" : std::string(name).substr(0, 256);
      if (trace_.others.size() < kMaxOthers || trace_.others.contains(other))
        ++trace_.others[other];
      return true;
    }
    if (trace_.events.size() >= kMaxTraceEvents) return false;
    TraceEvent taken;
    taken.kind = kind->second;
    const bt_stream_class* stream =
        bt_stream_borrow_class_const(bt_event_borrow_stream_const(event));
    if (bt_stream_class_borrow_default_clock_class_const(stream) != nullptr)
      (void)bt_clock_snapshot_get_ns_from_origin(
          bt_message_event_borrow_default_clock_snapshot_const(message), &taken.time_ns);
    const bt_field* own = bt_event_borrow_payload_field_const(event);
    const bt_field* context = bt_event_borrow_common_context_field_const(event);
    taken.process = signed_of(number(context, "vpid").value_or(number(context, "pid").value_or(0)));
    taken.thread = signed_of(number(context, "vtid").value_or(number(context, "tid").value_or(0)));
    if (const bt_packet* packet = packet_of(stream, event))
      taken.cpu = static_cast<std::int32_t>(
          number(bt_packet_borrow_context_field_const(packet), "cpu_id").value_or(~0ULL));
    const WantedEvent& wanted = wanted_[static_cast<std::size_t>(taken.kind)];
    for (std::size_t n = 0; n < wanted.numbers.size() && wanted.numbers[n] != nullptr; ++n)
      taken.numbers[n] = number(own, wanted.numbers[n]).value_or(0);
    taken.texts = static_cast<std::uint32_t>(trace_.texts.size());
    for (std::size_t t = 0; t < wanted.texts.size() && wanted.texts[t] != nullptr; ++t) {
      trace_.texts.push_back(text(own, wanted.texts[t]));
      bytes_ += trace_.texts.back().size() + sizeof(std::string);
    }
    if (bytes_ > kMaxTraceText) return false;
    trace_.events.push_back(taken);
    return true;
  }

  static std::int64_t signed_of(std::uint64_t bits) { return static_cast<std::int64_t>(bits); }

  static const bt_packet* packet_of(const bt_stream_class* stream, const bt_event* event) {
    return bt_stream_class_supports_packets(stream) == BT_TRUE ? bt_event_borrow_packet_const(event)
                                                               : nullptr;
  }

  static const bt_field* member(const bt_field* fields, const char* name) {
    if (fields == nullptr || bt_field_get_class_type(fields) != BT_FIELD_CLASS_TYPE_STRUCTURE)
      return nullptr;
    return bt_field_structure_borrow_member_field_by_name_const(fields, name);
  }

  static std::optional<std::uint64_t> number(const bt_field* fields, const char* name) {
    const bt_field* field = member(fields, name);
    if (field == nullptr) return std::nullopt;
    const bt_field_class_type type = bt_field_get_class_type(field);
    if (bt_field_class_type_is(type, BT_FIELD_CLASS_TYPE_UNSIGNED_INTEGER))
      return bt_field_integer_unsigned_get_value(field);
    if (bt_field_class_type_is(type, BT_FIELD_CLASS_TYPE_SIGNED_INTEGER))
      return static_cast<std::uint64_t>(bt_field_integer_signed_get_value(field));
    return std::nullopt;
  }

  static std::string text(const bt_field* fields, const char* name) {
    const bt_field* field = member(fields, name);
    if (field == nullptr || bt_field_get_class_type(field) != BT_FIELD_CLASS_TYPE_STRING) return {};
    const std::string value = bt_field_string_get_value(field);
    return value.substr(0, kMaxField);
  }

  const std::vector<WantedEvent>& wanted_;
  Trace& trace_;
  std::unordered_map<std::string, int> kinds_;
  std::size_t bytes_ = 0;
};

/// The sink of a graph.
struct Sink {
  Collector* collector;
  Iterator messages;
  bool full = false;
};

bt_graph_simple_sink_component_initialize_func_status begin(bt_message_iterator* messages,
                                                            void* sink) {
  bt_message_iterator_get_ref(messages);
  static_cast<Sink*>(sink)->messages.reset(messages);
  return BT_GRAPH_SIMPLE_SINK_COMPONENT_INITIALIZE_FUNC_STATUS_OK;
}

bt_graph_simple_sink_component_consume_func_status consume(bt_message_iterator* messages,
                                                           void* sink) {
  bt_message_array_const list = nullptr;
  std::uint64_t count = 0;
  const auto status = bt_message_iterator_next(messages, &list, &count);
  if (status != BT_MESSAGE_ITERATOR_NEXT_STATUS_OK)
    return static_cast<bt_graph_simple_sink_component_consume_func_status>(status);
  auto* const to = static_cast<Sink*>(sink);
  for (std::uint64_t m = 0; m < count; ++m) {
    to->full = to->full || !to->collector->take(list[m]);
    bt_message_put_ref(list[m]);
  }
  return to->full ? BT_GRAPH_SIMPLE_SINK_COMPONENT_CONSUME_FUNC_STATUS_END
                  : BT_GRAPH_SIMPLE_SINK_COMPONENT_CONSUME_FUNC_STATUS_OK;
}

void finish(void* sink) {
  static_cast<Sink*>(sink)->messages.reset();
}

class Reading {
 public:
  Reading(const std::vector<const char*>& providers, const std::vector<WantedEvent>& wanted,
          Trace& trace)
      : trace_(trace), collector_(providers, wanted, trace) {}

  Status find_reader() {
    const bt_plugin* found = nullptr;
    if (bt_plugin_find("ctf", BT_TRUE, BT_TRUE, BT_TRUE, BT_TRUE, BT_FALSE, &found) !=
        BT_PLUGIN_FIND_STATUS_OK)
      return fail(ErrorCode::kUnavailable, "has no plug-in 'ctf': " + cause(), "libbabeltrace2",
                  "install libbabeltrace2-0 again");
    plugin_.reset(found);
    source_ = bt_plugin_borrow_source_component_class_by_name_const(found, "fs");
    if (source_ == nullptr)
      return fail(ErrorCode::kUnavailable, "its plug-in 'ctf' has no source.ctf.fs",
                  "libbabeltrace2", "install libbabeltrace2-0 again");
    return {};
  }

  void read(const std::string& folder) {
    if (!whole_metadata(fs::path(folder) / "metadata"))
      return broken(folder,
                    "its metadata are no text, or end amid a packet: nothing of it is read");
    if (opens(folder).empty())
      read_streams(folder);
    else
      salvage(folder);
  }

 private:
  void read_streams(const std::string& folder) {
    for (std::uint64_t stream = 0; stream < kMaxStreams && !full_; ++stream)
      if (!read_stream(folder, stream)) return;
  }

  /// Why the trace cannot be opened; empty: it can.
  std::string opens(const std::string& folder) {
    const Graph graph(bt_graph_create(0));
    const bt_component_source* source = nullptr;
    return graph && add_source(graph.get(), folder, &source) ? std::string() : cause();
  }

  /// The library opens no trace of which a stream ends amid a packet, as streams do whose machine went down. So each
  /// stream is copied, and cut to the most whole pages with which it opens: a packet is pages of LTTng's.
  void salvage(const std::string& folder) {
    char name[] = "/tmp/xauto-import-XXXXXX";
    if (mkdtemp(name) == nullptr) return broken(folder, "no folder in /tmp to mend it in");
    const fs::path mended(name);
    std::error_code error;
    fs::copy_file(fs::path(folder) / "metadata", mended / "metadata", error);
    std::vector<fs::path> streams;
    for (const auto& entry : fs::directory_iterator(folder, error))
      if (entry.is_regular_file(error) && entry.path().filename() != "metadata")
        streams.push_back(entry.path());
    std::ranges::sort(streams);
    if (streams.size() > kMaxStreams) streams.resize(kMaxStreams);
    for (const fs::path& stream : streams) {
      const fs::path copy = mended / stream.filename();
      if (fs::file_size(stream, error) > kMaxMended) {
        broken(stream.filename().string(), "damaged, and larger than 1 GiB: left out");
        continue;
      }
      fs::copy_file(stream, copy, error);
      if (!error) mend(mended.string(), copy);
      fs::remove(copy, error);
    }
    fs::remove_all(mended, error);
  }

  /// Reads what of this stream, the only one in the folder, opens.
  void mend(const std::string& folder, const fs::path& stream) {
    std::error_code error;
    std::uintmax_t size = fs::file_size(stream, error);
    std::string why = opens(folder);
    const std::string first = why;
    for (std::size_t tries = 0; !why.empty() && size > 0 && tries < kMostCuts; ++tries) {
      size = size % kPage != 0 ? size - size % kPage : size - kPage;
      fs::resize_file(stream, size, error);
      if (size > 0) why = opens(folder);
    }
    if (!first.empty())
      broken(stream.filename().string(),
             first + "; read are its first " + std::to_string(why.empty() ? size : 0) + " bytes");
    if (why.empty()) read_streams(folder);
  }

  bool add_source(bt_graph* graph, const std::string& folder, const bt_component_source** source) {
    const Value parameters(bt_value_map_create());
    bt_value* inputs = nullptr;
    return parameters &&
           bt_value_map_insert_empty_array_entry(parameters.get(), "inputs", &inputs) ==
               BT_VALUE_MAP_INSERT_ENTRY_STATUS_OK &&
           bt_value_array_append_string_element(inputs, folder.c_str()) ==
               BT_VALUE_ARRAY_APPEND_ELEMENT_STATUS_OK &&
           bt_graph_add_source_component(graph, source_, "trace", parameters.get(),
                                         BT_LOGGING_LEVEL_NONE,
                                         source) == BT_GRAPH_ADD_COMPONENT_STATUS_OK;
  }

  void broken(const std::string& folder, const std::string& why) {
    if (trace_.broken.size() < kMaxBroken) trace_.broken.push_back(folder + ": " + why);
  }

  /// False: there is none of this number, or nothing of the trace can be read.
  bool read_stream(const std::string& folder, std::uint64_t stream) {
    Sink sink{&collector_, nullptr};  // before the graph, which ends first
    const Graph graph(bt_graph_create(0));
    const bt_component_source* source = nullptr;
    const bt_component_sink* to = nullptr;
    if (!graph || !add_source(graph.get(), folder, &source) ||
        bt_graph_add_simple_sink_component(graph.get(), "events", begin, consume, finish, &sink,
                                           &to) != BT_GRAPH_ADD_COMPONENT_STATUS_OK) {
      broken(folder, cause());
      return false;
    }
    if (stream >= bt_component_source_get_output_port_count(source)) return false;
    const bt_port_output* out =
        bt_component_source_borrow_output_port_by_index_const(source, stream);
    const std::string name = bt_port_get_name(bt_port_output_as_port_const(out));
    if (bt_graph_connect_ports(graph.get(), out,
                               bt_component_sink_borrow_input_port_by_index_const(to, 0),
                               nullptr) != BT_GRAPH_CONNECT_PORTS_STATUS_OK ||
        bt_graph_run(graph.get()) != BT_GRAPH_RUN_STATUS_OK)
      broken(name.empty() ? folder : fs::path(name).filename().string(), cause());
    full_ = sink.full;
    if (full_)
      broken(folder, "more than this program takes: " + std::to_string(kMaxTraceEvents) +
                         " events, or too much text");
    return true;
  }

  Trace& trace_;
  Collector collector_;
  Plugin plugin_;
  const bt_component_class_source* source_ = nullptr;
  bool full_ = false;
};

/// Folders that have a trace's metadata.
std::vector<std::string> traces_below(const std::string& folder) {
  std::vector<std::string> found;
  std::error_code error;
  if (fs::is_regular_file(fs::path(folder) / "metadata", error)) found.push_back(folder);
  fs::recursive_directory_iterator entry(folder, fs::directory_options::skip_permission_denied,
                                         error);
  for (; !error && entry != fs::recursive_directory_iterator(); entry.increment(error)) {
    if (entry.depth() >= kMaxDepth) entry.disable_recursion_pending();
    if (entry->is_directory(error) && fs::is_regular_file(entry->path() / "metadata", error))
      found.push_back(entry->path().string());
    error.clear();
    if (found.size() > kMaxTraces) break;
  }
  std::ranges::sort(found);
  return found;
}

}  // namespace

Result<Trace> read_ctf(const std::string& folder, const std::vector<const char*>& providers,
                       const std::vector<WantedEvent>& wanted) {
  const std::vector<std::string> folders = traces_below(folder);
  if (folders.empty())
    return fail(ErrorCode::kNotFound,
                "there is no LTTng trace: no file 'metadata' is in it or below", folder,
                "name the folder that `lttng create` or `ros2 trace` made");
  if (folders.size() > kMaxTraces)
    return fail(ErrorCode::kInvalid, "more than " + std::to_string(kMaxTraces) + " traces", folder,
                "name the folder of one session");
  Trace trace;
  Reading reading(providers, wanted, trace);
  XAUTO_TRY(reading.find_reader());
  for (const std::string& one : folders) reading.read(one);
  std::ranges::stable_sort(trace.events, {}, &TraceEvent::time_ns);
  return trace;
}

}  // namespace xauto::import
