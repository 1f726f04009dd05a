#include "lib/base/read_section.h"

#include <gtest/gtest.h>

#include <atomic>
#include <memory>
#include <optional>
#include <thread>
#include <vector>

namespace splinemap::read_section_test {

// Retires so much else that all is let go that may be.
void RetireMuch() {
  for (int n = 0; n < 200; ++n) ReadSection::Retire(std::make_shared<int>(n));
}

TEST(ReadSectionTest, NothingIsLetGoUnderASectionThatBeganBefore) {
  auto object = std::make_shared<int>(1);
  const std::weak_ptr<int> watched = object;
  {
    const ReadSection section;
    {
      const ReadSection nested;
    }
    ReadSection::Retire(std::move(object));
    RetireMuch();
    EXPECT_FALSE(watched.expired());
  }
  RetireMuch();
  EXPECT_TRUE(watched.expired());
}

TEST(ReadSectionTest, SectionsOfOtherThreadsCountToo) {
  std::atomic<int> step = 0;
  std::jthread reader([&] {
    const ReadSection section;
    step = 1;
    step.notify_all();
    step.wait(1);
  });
  step.wait(0);
  auto object = std::make_shared<int>(1);
  const std::weak_ptr<int> watched = object;
  ReadSection::Retire(std::move(object));
  RetireMuch();
  EXPECT_FALSE(watched.expired());
  step = 2;
  step.notify_all();
  reader.join();
  RetireMuch();
  EXPECT_TRUE(watched.expired());
}

TEST(ReadSectionTest, SectionsThatBeginLaterHoldNothingUp) {
  auto object = std::make_shared<int>(1);
  const std::weak_ptr<int> watched = object;
  ReadSection::Retire(std::move(object));
  std::optional<ReadSection> section;
  for (int n = 0; n < 3; ++n) {
    RetireMuch();
    section.emplace();
  }
  EXPECT_TRUE(watched.expired());
}

// A place whose content others exchange: readers must never see one that is gone.
TEST(ReadSectionTest, ReadersNeverSeeWhatIsGone) {
  struct Content {
    std::atomic<int> value = 1;
    ~Content() { value = 0; }
  };
  std::shared_ptr<Content> owner = std::make_shared<Content>();
  std::atomic<Content*> place = owner.get();
  std::atomic<bool> is_over = false;
  std::atomic<int64_t> reads = 0;
  std::vector<std::jthread> readers;
  for (int n = 0; n < 3; ++n) {
    readers.emplace_back([&] {
      while (!is_over) {
        const ReadSection section;
        ASSERT_EQ(place.load(std::memory_order_acquire)->value, 1);
        ++reads;
      }
    });
  }
  while (reads < 1000) std::this_thread::yield();
  for (int n = 0; n < 20'000; ++n) {
    auto next = std::make_shared<Content>();
    place = next.get();
    owner.swap(next);
    ReadSection::Retire(std::move(next));
  }
  is_over = true;
}

}  // namespace splinemap::read_section_test
