// SPDX-License-Identifier: Apache-2.0
// What `xauto import` reads. The first byte says what the rest is: t, p: trtexec's times, profile; a: CARET's
// architecture; i: app.json with "seen"; m: a model of Amalthea; n: an export of Nsight Systems; o: an ONNX model; r: what one holds, eight
// bytes each; e: events of a ROS 2 trace, eight bytes each.
#include <cstdlib>
#include <fstream>
#include <string>
#include <string_view>

#include <unistd.h>

#include "model/json.h"

#include "import/amalthea.h"
#include "import/architecture.h"
#include "import/nsight.h"
#include "import/onnx_net.h"
#include "import/ros2_app.h"
#include "import/skeleton.h"
#include "import/trtexec.h"

namespace {

using namespace xauto;

constexpr const char* kOrigin = "input";

/// What was made is read again, and is the same.
void check_made(const ImportedApp& made) {
  const auto again = parse_imported(to_json(made), kOrigin);
  if (!again || to_json(*again) != to_json(made)) std::abort();
  (void)import::skeleton(made, "0.2");
}

void read_engine(std::string_view text, bool times) {
  std::vector<std::string> lines;
  const std::vector<import::EngineTimes> usual = {{"net", "gpu", {1000, 2000}}};
  if (times) {
    const auto read = import::parse_trtexec_times(text, kOrigin);
    if (!read) return;
    const std::vector<import::EngineTimes> engines = {{"net", "gpu", *read}};
    ImportedApp made = import::app_of_engines(engines, "nets");
    if (import::add_engines(engines, 20, made, lines))
      check_made(*parse_imported(to_json(made), kOrigin));
    return;
  }
  const auto layers = import::parse_trtexec_profile(text, kOrigin);
  if (!layers) return;
  ImportedApp made = import::app_of_engines(usual, "nets");
  if (import::add_engines(usual, 0, made, lines) &&
      import::cut_at_layers("net", *layers, 3, made, lines))
    check_made(*parse_imported(to_json(made), kOrigin));
}

void read_model(std::string_view text) {
  const auto model = import::parse_amalthea({{kOrigin, std::string(text)}});
  std::vector<std::string> lines;
  if (!model) return;
  (void)import::amalthea_platform(*model, "soc");
  if (const auto made = import::amalthea_app(*model, {"app", 10}, lines)) check_made(*made);
}

std::string scratch() {
  static const std::string path = [] {
    const bool shm = access("/dev/shm", W_OK) == 0;
    return std::string(shm ? "/dev/shm" : "/tmp") + "/xauto_fuzz_import." +
           std::to_string(getpid());
  }();
  static const int at_exit = std::atexit([] { unlink(scratch().c_str()); });
  (void)at_exit;
  return path;
}

void make_of_nsight(const import::NsightTrace& trace) {
  std::vector<std::string> lines;
  if (const auto made = import::nsight_app(trace, {"app", "export", 10}, lines)) check_made(*made);
}

void read_export(std::string_view bytes) {
  std::ofstream(scratch(), std::ios::binary)
      .write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  if (const auto trace = import::read_nsight(scratch())) make_of_nsight(*trace);
}

void cut_net(std::string_view bytes) {
  const auto net = import::OnnxNet::parse(bytes, kOrigin);
  if (!net) return;
  (void)net->external_files();
  const auto at = import::even_cuts(*net, net->cuts(2), {}, 3);
  std::size_t nodes = 0;
  for (const import::OnnxPart& part : net->parts(at)) {
    nodes += part.nodes.size();
    if (!import::OnnxNet::parse(part.model, kOrigin)) std::abort();
  }
  if (nodes != net->nodes().size()) std::abort();
  check_made(*parse_imported(to_json(import::app_of_parts("net", nodes, at, {}, 10)), kOrigin));
}

/// A range, a call or a kernel for each eight bytes.
void read_rows(std::string_view bytes) {
  import::NsightTrace trace;
  std::int64_t now_ns = 0;
  for (; bytes.size() >= 8; bytes.remove_prefix(8)) {
    const auto byte = [&](std::size_t n) {
      return static_cast<std::int64_t>(static_cast<unsigned char>(bytes[n]));
    };
    now_ns += byte(1) * byte(1) * 1000;
    const std::int64_t end_ns = now_ns + byte(2) * byte(3) * 1000;
    const std::int64_t thread = byte(4) % 3 + 1;
    if (byte(0) % 3 == 0)
      trace.ranges.push_back(
          {std::string(1, static_cast<char>('a' + byte(5) % 4)), now_ns, end_ns, thread});
    else if (byte(0) % 3 == 1)
      trace.calls.push_back({now_ns, end_ns, thread, byte(6), byte(7) % 2 == 0});
    else
      trace.work.push_back(
          {byte(7) % 4 == 0, byte(5) % 2, now_ns, end_ns, byte(5) % 3 - 1, byte(6), thread});
  }
  make_of_nsight(trace);
}

void read_events(std::string_view bytes) {
  import::Trace trace;
  trace.texts = {"/a", "/b", "multi_threaded_executor", "reentrant"};
  std::int64_t now_ns = 1'000'000'000;
  while (bytes.size() >= 8) {
    const auto byte = [&](std::size_t n) {
      return static_cast<std::uint64_t>(static_cast<unsigned char>(bytes[n]));
    };
    import::TraceEvent event;
    event.kind = static_cast<int>(byte(0) % import::ros2_events().size());
    now_ns += static_cast<std::int64_t>(byte(1) * byte(1)) * 1000;
    event.time_ns = now_ns;
    event.process = 1;
    event.thread = static_cast<std::int64_t>(byte(2) % 3);
    event.cpu = static_cast<std::int32_t>(byte(2) % 3);
    event.texts = static_cast<std::uint32_t>(byte(3) % 4);
    event.numbers = {byte(4), byte(5) << (byte(7) % 30), byte(6)};
    trace.events.push_back(event);
    bytes.remove_prefix(8);
  }
  const auto read = import::ros2_trace_of(trace, kOrigin);
  std::vector<std::string> lines;
  if (!read) return;
  if (const auto made = import::ros2_app(*read, {}, {"app", "trace", 10}, lines)) check_made(*made);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::string_view text(reinterpret_cast<const char*>(data) + 1, size - 1);
  switch (data[0]) {
    case 't':
    case 'p':
      read_engine(text, data[0] == 't');
      break;
    case 'a':
      (void)import::parse_architecture(text, kOrigin);
      break;
    case 'm':
      read_model(text);
      break;
    case 'n':
      read_export(text);
      break;
    case 'o':
      cut_net(text);
      break;
    case 'r':
      read_rows(text);
      break;
    case 'i':
      if (const auto read = parse_imported(text, kOrigin)) check_made(*read);
      break;
    default:
      read_events(text);
  }
  return 0;
}
