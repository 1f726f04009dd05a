#pragma once

#include <vector>

#include "lcmtypes/splinemap/layer_command_request_t.hpp"
#include "services/splinemapd/folding_thread.h"
#include "services/splinemapd/map_saver.h"
#include "services/splinemapd/mapping_thread.h"
#include "services/splinemapd/newest_map.h"
#include "services/splinemapd/notice_log.h"
#include "services/splinemapd/replication_thread.h"
#include "services/splinemapd/request_server.h"
#include "splinemap/layer_command.h"

namespace splinemap {

// Executes the commands of clients: each by a task for the thread that owns what it changes, and
// then a save. Thread-safe.
class CommandHandlers {
 public:
  // The others outlive it. Without `allowed` all commands are refused with PermissionDenied.
  CommandHandlers(bool allowed, NewestMap& newest, MappingThread& mapping, FoldingThread& folding,
                  ReplicationThread& replication, MapSaver& saver, NoticeLog& notices)
      : allowed_(allowed),
        newest_(newest),
        mapping_(mapping),
        folding_(folding),
        replication_(replication),
        saver_(saver),
        notices_(notices) {}

  // An encoded command_request_t or layer_command_request_t. Does not wait.
  void Execute(const std::vector<uint8_t>& command, RequestServer::Done done);

 private:
  void Save(RequestServer::Done done);
  void Clear(uint64_t session_number, RequestServer::Done done);
  void ChangeLayer(const layer_command_request_t& request, RequestServer::Done done);
  // `placement` is for kPlace, beyond where the layer was mapped.
  void ChangeSettings(LayerCommand command, const layer_command_request_t& request,
                      const FixedPose2& placement, RequestServer::Done done);
  void PlaceOwn(const layer_command_request_t& request, const FixedPose2& placement,
                RequestServer::Done done);
  // FailedPrecondition where the own layer is in another session.
  absl::Status CheckSession(uint64_t session_number) const;

  const bool allowed_;
  NewestMap& newest_;
  MappingThread& mapping_;
  FoldingThread& folding_;
  ReplicationThread& replication_;
  MapSaver& saver_;
  NoticeLog& notices_;
};

}  // namespace splinemap
