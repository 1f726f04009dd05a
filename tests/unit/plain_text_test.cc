#include "lib/base/plain_text.h"

#include <gtest/gtest.h>

namespace splinemap::plain_text_test {

TEST(PlainTextTest, WhatIsPlainStaysTheSame) {
  for (const std::string text : {"", "robot-7", "a \"name\" with 'quotes' and \\x1b",
                                 "R\u00fcdiger \u673a\u5668\u4eba", "\U0001f916"}) {
    EXPECT_EQ(PlainText(text), text);
  }
}

TEST(PlainTextTest, WhatSteersATerminalIsShown) {
  EXPECT_EQ(PlainText("\x1b[2J\n\r\t\x7f"), "\\x1b[2J\\x0a\\x0d\\x09\\x7f");
  EXPECT_EQ(PlainText(std::string("a\0b", 3)), "a\\x00b");
  EXPECT_EQ(PlainText("\u009b2J"), "\\xc2\\x9b2J") << "as ESC [";
  EXPECT_EQ(PlainText("a\u2028b\u202ec\u2066d\u200f"),
            "a\\xe2\\x80\\xa8b\\xe2\\x80\\xaec\\xe2\\x81\\xa6d\\xe2\\x80\\x8f");
}

TEST(PlainTextTest, BytesThatAreNoUtf8AreShown) {
  EXPECT_EQ(PlainText("\xff\xfe"), "\\xff\\xfe");
  EXPECT_EQ(PlainText("a\xc3"), "a\\xc3") << "ends early";
  EXPECT_EQ(PlainText("\xc0\x9b"), "\\xc0\\x9b") << "overlong";
  EXPECT_EQ(PlainText("\xe0\x80\x9b"), "\\xe0\\x80\\x9b") << "overlong";
  EXPECT_EQ(PlainText("\xed\xa0\x80"), "\\xed\\xa0\\x80") << "half of a pair";
  EXPECT_EQ(PlainText("\xf5\x80\x80\x80"), "\\xf5\\x80\\x80\\x80") << "beyond Unicode";
  EXPECT_EQ(PlainText("\x9b\xc3\xbc"), "\\x9b\u00fc") << "what follows is read on";
}

TEST(PlainTextTest, LinesStayLinesWhereThatIsWanted) {
  EXPECT_EQ(PlainLines("a\n\x1b b\n"), "a\n\\x1b b\n");
}

}  // namespace splinemap::plain_text_test
