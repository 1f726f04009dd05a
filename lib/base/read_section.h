#pragma once

#include <atomic>
#include <cstdint>
#include <memory>

namespace splinemap {

// While a thread has one, what others retire is not freed under it: so it reads by plain pointers,
// without a lock or a count. Costs two writes to memory of its own. May be nested; short, since
// memory waits for it. (Epoch-based reclamation: K. Fraser, Practical lock-freedom, 2004.)
class ReadSection {
 public:
  ReadSection() : slot_(SlotOfThread()) {
    if (slot_.depth++ > 0) return;
    // Nothing is read of what is shared before the epoch is.
    slot_.epoch.store(epoch_.load(std::memory_order_acquire), std::memory_order_release);
    // Whoever frees orders this thread's writes before its reads, where the system can do that.
    if (needs_fence_.load(std::memory_order_relaxed)) {
      std::atomic_thread_fence(std::memory_order_seq_cst);
    } else {
      std::atomic_signal_fence(std::memory_order_seq_cst);
    }
  }
  ~ReadSection() {
    if (--slot_.depth == 0) slot_.epoch.store(kOutside, std::memory_order_release);
  }
  ReadSection(const ReadSection&) = delete;
  ReadSection& operator=(const ReadSection&) = delete;

  // Lets go of it once no section goes on that began before. Requires that nobody finds it any more
  // who begins one now.
  static void Retire(std::shared_ptr<const void> retired);

 private:
  friend struct ReadSlots;
  static constexpr uint64_t kOutside = 0;
  struct alignas(64) Slot {
    std::atomic<uint64_t> epoch{kOutside};  // in which the thread began its outermost section
    int depth = 0;                          // of the thread alone
    bool is_taken = true;
  };
  static Slot& SlotOfThread() {
    thread_local Slot* slot = nullptr;
    if (slot == nullptr) slot = &TakeSlot();
    return *slot;
  }
  // Until the thread ends. What is destroyed with a thread begins no section.
  static Slot& TakeSlot();

  static inline std::atomic<uint64_t> epoch_{1};
  static inline std::atomic<bool> needs_fence_{true};

  Slot& slot_;
};

}  // namespace splinemap
