#include "lib/base/read_section.h"

#ifdef __linux__
#include <linux/membarrier.h>
#include <sys/syscall.h>
#include <unistd.h>
#endif

#include <algorithm>
#include <deque>
#include <utility>
#include <vector>

#include "lib/base/mutex.h"

namespace splinemap {
namespace {

// Retired things wait for so many more, so that looking at all threads costs little.
constexpr size_t kAtOnce = 64;

#ifdef __linux__
// A memory barrier in each thread of the process that runs.
bool BarrierInAllThreads(int command) { return syscall(__NR_membarrier, command, 0, 0) == 0; }
bool CanHaveBarriers() { return BarrierInAllThreads(MEMBARRIER_CMD_REGISTER_PRIVATE_EXPEDITED); }
void BarrierInAllThreads() { BarrierInAllThreads(MEMBARRIER_CMD_PRIVATE_EXPEDITED); }
#else
bool CanHaveBarriers() { return false; }
void BarrierInAllThreads() {}
#endif

}  // namespace

// Of all threads that have read, and what waits for them. Never freed: threads may end later.
struct ReadSlots {
  struct Retired {
    uint64_t epoch;
    std::shared_ptr<const void> object;
  };
  Mutex mutex;
  std::deque<ReadSection::Slot> slots ABSL_GUARDED_BY(mutex);
  std::vector<Retired> retired ABSL_GUARDED_BY(mutex);

  ReadSlots() { ReadSection::needs_fence_ = !CanHaveBarriers(); }

  static ReadSlots& Get() {
    static auto& slots = *new ReadSlots();
    return slots;
  }

  ReadSection::Slot& Take() {
    MutexLock lock(mutex);
    const auto free = std::ranges::find(slots, false, &ReadSection::Slot::is_taken);
    if (free == slots.end()) return slots.emplace_back();
    free->is_taken = true;
    return *free;
  }

  void GiveBack(ReadSection::Slot& slot) {
    MutexLock lock(mutex);
    slot.is_taken = false;
  }

  // Those that may be let go.
  std::vector<Retired> TakeUnread() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex) {
    ReadSection::epoch_.fetch_add(1);
    BarrierInAllThreads();
    std::atomic_thread_fence(std::memory_order_seq_cst);
    uint64_t oldest = ReadSection::epoch_;
    for (const ReadSection::Slot& slot : slots) {
      const uint64_t epoch = slot.epoch.load(std::memory_order_acquire);
      if (epoch != ReadSection::kOutside) oldest = std::min(oldest, epoch);
    }
    const auto is_read = [&](const Retired& one) { return one.epoch >= oldest; };
    const auto begin = std::stable_partition(retired.begin(), retired.end(), is_read);
    std::vector<Retired> unread(std::make_move_iterator(begin),
                                std::make_move_iterator(retired.end()));
    retired.erase(begin, retired.end());
    return unread;
  }
};

ReadSection::Slot& ReadSection::TakeSlot() {
  struct Owner {
    Slot& slot = ReadSlots::Get().Take();
    ~Owner() { ReadSlots::Get().GiveBack(slot); }
  };
  thread_local Owner owner;
  return owner.slot;
}

void ReadSection::Retire(std::shared_ptr<const void> retired) {
  ReadSlots& slots = ReadSlots::Get();
  std::vector<ReadSlots::Retired> unread;  // let go without the lock
  MutexLock lock(slots.mutex);
  slots.retired.push_back({epoch_.load(), std::move(retired)});
  if (slots.retired.size() % kAtOnce == 0) unread = slots.TakeUnread();
}

}  // namespace splinemap
