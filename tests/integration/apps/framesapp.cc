// SPDX-License-Identifier: Apache-2.0
// Frames in buffers, from a camera that uses few of them again and again.
//
//   camera ─► look                 reads each frame
//         └─► crop ─► end          hands the same buffer on; end reads it
//
//   framesapp FILE [crash MODULE NUMBER]   that module kills its process at that release, in its first process only
//
// One line per activation: "look 7 4711 12 ok", its release, the inode of the memory, the descriptors of the process, and whether
// all of the frame is that release's. "camera 7 4711", or "camera 7 none": no buffer was free.
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <stdexcept>
#include <string>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <xauto/xauto.h>

#include "tests/open_descriptors.h"

using namespace std::chrono_literals;

namespace {

constexpr std::size_t kFrameBytes = 1 << 20;
constexpr std::size_t kBuffers = 6;

struct FrameInfo {
  std::uint64_t number;
};
using Frame = xauto::Buffered<FrameInfo>;

int g_file = -1;
std::string g_told, g_crash;
std::uint64_t g_crash_at = 0;

/// One write, so that lines of several processes do not mix.
void tell(const std::string& line) {
  const std::string text = line + "\n";
  if (write(g_file, text.data(), text.size()) < 0) std::abort();
}

std::string inode(const xauto::Buffer& buffer) {
  struct stat status {};
  if (fstat(buffer.fd(), &status) != 0) return "none";
  return std::to_string(status.st_ino);
}

Frame take_picture(std::uint64_t number) {
  static const auto pool = xauto::BufferPool::make(kBuffers, kFrameBytes);
  if (!pool) throw std::runtime_error(pool.error().to_string());
  Frame frame;
  frame.info.number = number;
  if (auto free = pool->acquire()) {
    const auto to = free->write();
    if (!to) throw std::runtime_error(to.error().to_string());
    for (std::size_t at = 0; at < to->bytes().size(); at += sizeof number)
      std::memcpy(to->bytes().data() + at, &number, sizeof number);
    frame.buffer = std::move(*free);
  }
  tell("camera " + std::to_string(number) + " " + inode(frame.buffer));
  return frame;
}

bool is_whole(const Frame& frame) {
  const auto from = frame.buffer.read();
  if (!from || from->bytes().size() != kFrameBytes) return false;
  for (std::size_t at = 0; at < kFrameBytes; at += sizeof frame.info.number)
    if (std::memcmp(from->bytes().data() + at, &frame.info.number, sizeof frame.info.number) != 0)
      return false;
  return true;
}

struct State {
  Frame frame;
};

/// Looks at the frame on `topic`, and tells so; keeps it in the state if `keep`.
xauto::XNode<State> stage(const std::string& name, const xauto::Topic<Frame>& topic, bool keep) {
  xauto::XNode<State> made(name + ".x");
  made.add_impl(
      xauto::XPU::CPU, [](const xauto::XpuId&) { return xauto::SchedHandle::gate(); },
      [name, topic, keep](State& state, const xauto::Input& in) {
        const Frame& frame = in.get(topic);
        const std::string release = std::to_string(in.sequence());
        if (name == g_crash && in.sequence() >= g_crash_at) {  // once: the file says that it was
          const int mark = open((g_told + ".crashed").c_str(), O_CREAT | O_EXCL | O_CLOEXEC, 0600);
          if (mark >= 0) std::abort();
        }
        const bool good = !frame.buffer || (is_whole(frame) && frame.info.number == in.sequence());
        tell(name + " " + release + " " + inode(frame.buffer) + " " +
             std::to_string(xauto::open_descriptors()) + (good ? " ok" : " wrong"));
        if (keep) state.frame = frame;
      });
  return made;
}

}  // namespace

int main(int argc, char** argv) {
  g_told = argc > 1 ? argv[1] : "/dev/null";
  if (argc > 4 && std::string(argv[2]) == "crash") {
    g_crash = argv[3];
    g_crash_at = std::strtoull(argv[4], nullptr, 10);
  }
  g_file = open(g_told.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
  if (g_file < 0) return 2;

  const xauto::Topic<Frame> frames("frames"), cut("cut");
  xauto::App app("framesapp");
  app.add_source(frames, 5ms, take_picture);
  xauto::XModule<State> look("look"), crop("crop"), last("end");
  look.add_node(stage("look", frames, false)).add_input_topic(frames);
  crop.add_node(stage("crop", frames, true))
      .add_input_topic(frames)
      .add_output_topic(cut, &State::frame);
  last.add_node(stage("end", cut, false)).add_input_topic(cut);
  app.add_module(look).add_module(crop).add_module(last);
  return app.main(argc, argv);
}
