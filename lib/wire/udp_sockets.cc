#include "lib/wire/udp_sockets.h"

#include <dirent.h>
#include <dlfcn.h>
#include <linux/filter.h>
#include <linux/sock_diag.h>
#include <sys/socket.h>

#include <array>
#include <atomic>
#include <cstdint>
#include <cstdlib>
#include <iterator>
#include <vector>

#include "lib/base/mutex.h"

namespace splinemap {
namespace {

// An LCM datagram, all big-endian: magic and sequence number; in fragments then size of the
// message, place of the fragment in it, number of the fragment and how many there are; then, in the
// first fragment and in whole messages, the name of the channel and a closing 0.
constexpr uint32_t kWholeMagic = 0x4c433032;
constexpr uint32_t kFragmentMagic = 0x4c433033;
constexpr uint32_t kUdpHeader = 8;  // where filters begin to count
constexpr uint32_t kMessageSize = kUdpHeader + 8;
constexpr uint32_t kFragmentPlace = kUdpHeader + 12;
constexpr uint32_t kFragmentNumber = kUdpHeader + 16;
constexpr uint32_t kNameOfWhole = kUdpHeader + 8;
constexpr uint32_t kNameOfFragment = kUdpHeader + 20;
constexpr uint32_t kMaxName = 63;
constexpr uint32_t kMaxMessage = 1 << 20;

std::vector<sock_filter> Filter() {
  const sock_filter accept = BPF_STMT(BPF_RET | BPF_K, UINT32_MAX);
  // The datagram without its content, which liblcm ignores. Nothing at all would count as lost.
  const sock_filter refuse = BPF_STMT(BPF_RET | BPF_K, kUdpHeader);
  std::vector<sock_filter> filter = {
      BPF_STMT(BPF_LD | BPF_W | BPF_LEN, 0),
      BPF_JUMP(BPF_JMP | BPF_JGE | BPF_K, kNameOfWhole, 1, 0),
      accept,  // too short for LCM
      BPF_STMT(BPF_LD | BPF_W | BPF_ABS, kUdpHeader),
      BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, kWholeMagic, 14, 0),
      BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, kFragmentMagic, 1, 0),
      accept,
      BPF_STMT(BPF_LD | BPF_W | BPF_LEN, 0),
      BPF_JUMP(BPF_JMP | BPF_JGE | BPF_K, kNameOfFragment, 0, 4),
      BPF_STMT(BPF_LD | BPF_W | BPF_ABS, kMessageSize),
      BPF_JUMP(BPF_JMP | BPF_JGT | BPF_K, kMaxMessage, 2, 0),
      BPF_STMT(BPF_LD | BPF_W | BPF_ABS, kFragmentPlace),
      BPF_JUMP(BPF_JMP | BPF_JGT | BPF_K, kMaxMessage, 0, 1),
      refuse,
      BPF_STMT(BPF_LD | BPF_H | BPF_ABS, kFragmentNumber),
      BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, 0, 1, 0),
      accept,
      BPF_STMT(BPF_LDX | BPF_W | BPF_IMM, kNameOfFragment),
      BPF_STMT(BPF_JMP | BPF_JA, 1),
      BPF_STMT(BPF_LDX | BPF_W | BPF_IMM, kNameOfWhole),
  };
  // Byte k of the name, which begins at X; a filter has no loops.
  for (uint32_t k = 0; k <= kMaxName; ++k) {
    const sock_filter steps[] = {
        BPF_STMT(BPF_LD | BPF_W | BPF_LEN, 0),
        BPF_STMT(BPF_ALU | BPF_SUB | BPF_K, k),
        BPF_JUMP(BPF_JMP | BPF_JGT | BPF_X, 0, 1, 0),
        refuse,
        BPF_STMT(BPF_LD | BPF_B | BPF_IND, k),
        BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, 0, 0, 1),
        accept,
    };
    filter.insert(filter.end(), std::begin(steps), std::end(steps));
  }
  filter.push_back(refuse);
  return filter;
}

bool Is(int fd, int option, int value) {
  int actual = 0;
  socklen_t size = sizeof(actual);
  return getsockopt(fd, SOL_SOCKET, option, &actual, &size) == 0 && actual == value;
}

bool IsUdpSocket(int fd) { return Is(fd, SO_DOMAIN, AF_INET) && Is(fd, SO_TYPE, SOCK_DGRAM); }

// liblcm does not tell its own.
std::vector<int> UdpSockets() {
  std::vector<int> sockets;
  DIR* const fds = opendir("/proc/self/fd");
  if (fds == nullptr) return sockets;
  while (const dirent* entry = readdir(fds)) {
    const int fd = std::atoi(entry->d_name);  // "." and ".." become 0, which is no UDP socket
    if (IsUdpSocket(fd)) sockets.push_back(fd);
  }
  closedir(fds);
  return sockets;
}

std::atomic<int64_t> num_bound = 0;  // UDP sockets, so far

// What was there when a socket was bound last: to look through all descriptors once a second would
// be much of what an idle daemon does.
class KnownSockets {
 public:
  std::vector<int> Get() {
    MutexLock lock(mutex_);
    const int64_t bound = num_bound;
    if (bound != bound_) sockets_ = UdpSockets();
    bound_ = bound;
    return sockets_;
  }

 private:
  Mutex mutex_;
  int64_t bound_ ABSL_GUARDED_BY(mutex_) = 0;
  std::vector<int> sockets_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace

int64_t CountLostDatagrams() {
  static auto& known = *new KnownSockets;
  int64_t lost = 0;
  for (const int fd : known.Get()) {
    if (!IsUdpSocket(fd)) continue;  // it was closed meanwhile
    std::array<uint32_t, SK_MEMINFO_VARS> info{};
    socklen_t size = sizeof(info);
    if (getsockopt(fd, SOL_SOCKET, SO_MEMINFO, info.data(), &size) == 0) {
      lost += info[SK_MEMINFO_DROPS];
    }
  }
  return lost;
}

}  // namespace splinemap

// Stands before the bind() of the C library, also for liblcm, which binds and reads in one go.
extern "C" int bind(int fd, const sockaddr* address, socklen_t length) noexcept {
  using Bind = int (*)(int, const sockaddr*, socklen_t);
  static const auto real_bind = reinterpret_cast<Bind>(dlsym(RTLD_NEXT, "bind"));
  if (splinemap::IsUdpSocket(fd)) {
    ++splinemap::num_bound;
    std::vector<sock_filter> filter = splinemap::Filter();
    const sock_fprog program = {static_cast<unsigned short>(filter.size()), filter.data()};
    setsockopt(fd, SOL_SOCKET, SO_ATTACH_FILTER, &program, sizeof(program));
  }
  return real_bind(fd, address, length);
}
