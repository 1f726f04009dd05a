#pragma once

#include <atomic>
#include <cstdint>

namespace splinemap {

// Counts the steps of a thread's work, so that ThreadWatch sees whether it gets on. Thread-safe.
class WorkSteps {
 public:
  // The thread waits for work as long as this lives.
  class Waiting {
   public:
    explicit Waiting(WorkSteps& steps) : steps_(steps) { ++steps_.count_; }
    ~Waiting() { ++steps_.count_; }
    Waiting(const Waiting&) = delete;
    Waiting& operator=(const Waiting&) = delete;

   private:
    WorkSteps& steps_;
  };

  void Add() { count_ += 2; }

  // Another number with every step; odd while the thread waits.
  int64_t count() const { return count_; }

 private:
  std::atomic<int64_t> count_ = 0;
};

}  // namespace splinemap
