#pragma once

#include <string>

#include "services/splinemapd/notice_log.h"

namespace splinemap {

// The log of the program, on stderr: with time and level on a terminal or in a file, with the level
// as syslog has it, "<4>", where systemd's journal reads it, which knows the time. Texts of a bus
// or a file are shown plain.

// A line is written by a thread of its own: a terminal that is stopped, or a pipe that nobody
// reads, holds up that one only; beyond a queue the oldest lines are lost.
void StartLog();
// After the last line.
void EndLog();

// Reports lines of the log that were lost; `reported` of them were reported before.
void ReportLostLines(NoticeLog& notices, size_t& reported);

// An error before StartLog(), of one line or several.
void PrintError(const std::string& lines);

}  // namespace splinemap
