// SPDX-License-Identifier: Apache-2.0
// xauto::Buffer with a dmabuf, as a camera's driver exports one: the kernel's own udmabuf, over memory that this program sees as
// well, so that what went in and out is told by other means. xauto.ko has no part in this.
#include <cstdint>
#include <cstring>
#include <memory>
#include <vector>

#include <fcntl.h>
#include <kselftest.h>
#include <linux/udmabuf.h>
#include <signal.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "transport/shm_topic.h"

namespace {

using namespace xauto;

constexpr std::size_t kBytes = 1 << 20;

struct FrameInfo {
  std::uint64_t number;
};
using Frame = Buffered<FrameInfo>;

/// A dmabuf, and the same pages as this program has them.
struct Exported {
  UniqueFd dmabuf;
  std::uint64_t* pages = nullptr;
};

Exported export_pages(const UniqueFd& device) {
  Exported made;
  const UniqueFd memory(memfd_create("pages", MFD_CLOEXEC | MFD_ALLOW_SEALING));
  if (ftruncate(memory.get(), kBytes) != 0 || fcntl(memory.get(), F_ADD_SEALS, F_SEAL_SHRINK) != 0)
    ksft_exit_fail_msg("no memfd\n");
  udmabuf_create wanted{};
  wanted.memfd = static_cast<__u32>(memory.get());
  wanted.flags = UDMABUF_FLAGS_CLOEXEC;
  wanted.size = kBytes;
  made.dmabuf = UniqueFd(ioctl(device.get(), UDMABUF_CREATE, &wanted));
  void* at = mmap(nullptr, kBytes, PROT_READ | PROT_WRITE, MAP_SHARED, memory.get(), 0);
  if (!made.dmabuf || at == MAP_FAILED) ksft_exit_fail_msg("no dmabuf\n");
  made.pages = static_cast<std::uint64_t*>(at);
  return made;
}

ino_t inode(int fd) {
  struct stat status {};
  return fstat(fd, &status) == 0 ? status.st_ino : 0;
}

std::uint64_t last_word(const Buffer& buffer) {
  const auto from = buffer.read();
  if (!from) return 0;
  std::uint64_t word;
  std::memcpy(&word, from->bytes().data() + from->bytes().size() - sizeof word, sizeof word);
  return word;
}

void alone(const UniqueFd& device) {
  const Exported made = export_pages(device);
  const auto buffer = Buffer::adopt(made.dmabuf.get());
  ksft_test_result(buffer && buffer->is_dmabuf() && buffer->size() == kBytes,
                   "a dmabuf is adopted\n");
  if (!buffer) return;
  {
    const auto to = buffer->write();
    if (to) std::memset(to->bytes().data(), 0x5a, to->bytes().size());
  }
  bool all = true;
  for (std::size_t i = 0; i < kBytes / 8; ++i) all = all && made.pages[i] == 0x5a5a5a5a5a5a5a5a;
  ksft_test_result(all, "what is written is in its pages\n");
  made.pages[kBytes / 8 - 1] = 77;
  ksft_test_result(last_word(*buffer) == 77, "and what is in its pages is read\n");
}

/// Ends this process, a reader's: 0 when each frame is the exporter's memory and can be read, not written. One
/// frame is kept until somebody kills it; `told`, a pipe, says that the reader is there, and then that the frame is.
[[noreturn]] void read_frames(transport::Link& link, const detail::TopicSpec& spec, ino_t expected,
                              int frames, int told = -1) {
  const auto reader = link.subscriber(spec, 0);
  if (!reader || (told >= 0 && write(told, "", 1) != 1)) _exit(2);
  std::shared_ptr<const void> kept;
  for (int seen = 0; seen < frames;) {
    const auto envelope = (*reader)->take();
    if (!envelope) {
      usleep(1000);
      continue;
    }
    const auto* frame = static_cast<const Frame*>(envelope->message.get());
    if (frame == nullptr) _exit(3);
    if (!frame->buffer.is_dmabuf() || inode(frame->buffer.fd()) != expected) _exit(4);
    if (last_word(frame->buffer) != frame->info.number || frame->buffer.write()) _exit(5);
    kept = ++seen == frames ? envelope->message : nullptr;
  }
  if (frames > 1) _exit(0);
  if (write(told, "", 1) != 1) _exit(6);
  for (;;) pause();  // with the frame
}

void between_processes(const UniqueFd& device) {
  const Exported made = export_pages(device);
  const ino_t memory = inode(made.dmabuf.get());
  const auto pool = BufferPool::of({*Buffer::adopt(made.dmabuf.get())});
  detail::TopicSpec spec = *detail::topic_spec(Topic<Frame>("frames"));
  const auto link = transport::make_link({transport::chunk_bytes_of(spec), 1, 4, 4, true});
  if (!pool || !link) ksft_exit_fail_msg("no topic\n");
  const auto there = transport::join_link(*(*link)->invite(0));
  const auto publisher = (*link)->publisher(spec, nullptr);
  const auto publish = [&](std::uint64_t number) {
    auto frame = std::make_shared<Frame>();
    for (int tries = 0; tries < 10'000 && !frame->buffer; ++tries) {
      if (auto free = pool->acquire())
        frame->buffer = *free;
      else
        usleep(1000);
    }
    if (!frame->buffer) return false;
    made.pages[kBytes / 8 - 1] = number;
    frame->info.number = number;
    (*publisher)->publish({frame, 0, number});
    return true;
  };

  int status = -1;
  pid_t child = fork();
  if (child == 0) read_frames(**there, spec, memory, 100);
  bool all = true;
  for (std::uint64_t number = 0; number < 100; ++number) all = all && publish(number);
  waitpid(child, &status, 0);
  ksft_test_result(all && status == 0, "another process reads 100 frames in the one dmabuf\n");

  (*link)->release_all(0);
  int told[2];
  if (pipe2(told, O_CLOEXEC) != 0) ksft_exit_fail_msg("no pipe\n");
  child = fork();
  if (child == 0) read_frames(**there, spec, memory, 1, told[1]);
  close(told[1]);
  char byte = 0;
  // What was published before the second one asked for descriptors would be lost for it.
  all = read(told[0], &byte, 1) == 1 && publish(100);
  all = read(told[0], &byte, 1) == 1 && all;  // 0: it died before
  close(told[0]);
  ksft_test_result(all && !pool->acquire(), "who keeps a frame keeps the dmabuf\n");
  kill(child, SIGKILL);
  waitpid(child, &status, 0);
  (*link)->release_all(0);  // as the hub does
  ksft_test_result(pool->acquire().has_value(), "and has it no more when it is dead\n");
}

}  // namespace

int main() {
  const UniqueFd device(open("/dev/udmabuf", O_RDWR | O_CLOEXEC));
  setlinebuf(stdout);
  ksft_print_header();
  ksft_set_plan(device ? 6 : 1);
  if (!device) {
    ksft_test_result_skip("buffers of dmabufs: this kernel has no /dev/udmabuf\n");
    ksft_finished();
  }
  alone(device);
  between_processes(device);
  ksft_finished();
}
