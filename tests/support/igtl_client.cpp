// A client of libOpenIGTLink: what the reference implementation makes of our messages, and what it sends.
//
// igtl_client PORT FRAMES
//
// Sends FRAMES times TRANSFORM and POINT, then a request for the status, and prints what comes until a vessel, a tip
// and a status have been seen.

#include <igtlClientSocket.h>
#include <igtlMessageHeader.h>
#include <igtlPointMessage.h>
#include <igtlPolyDataMessage.h>
#include <igtlStatusMessage.h>
#include <igtlTimeStamp.h>
#include <igtlTransformMessage.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <vector>

static void send_frames(igtl::ClientSocket* socket, int frames)
{
  for (int k = 0; k < frames; k++) {
    igtl::TimeStamp::Pointer time = igtl::TimeStamp::New();
    // Eighths of a second, which the protocol's times hold exactly.
    time->SetTime(igtlUint32(1700000000 + k / 8), igtlUint32(125000000 * (k % 8)));

    igtl::TransformMessage::Pointer transform = igtl::TransformMessage::New();
    igtl::Matrix4x4 matrix;
    igtl::IdentityMatrix(matrix);
    matrix[0][3] = 0.5f * k;
    matrix[1][3] = -1.25f;
    transform->SetDeviceName("ProbeToTracker");
    transform->SetTimeStamp(time);
    transform->SetMatrix(matrix);
    transform->Pack();
    socket->Send(transform->GetPackPointer(), transform->GetPackSize());

    igtl::PointMessage::Pointer points = igtl::PointMessage::New();
    points->SetDeviceName("LumenContour");
    points->SetTimeStamp(time);
    for (int j = 0; j < 5; j++) {
      igtl::PointElement::Pointer point = igtl::PointElement::New();
      point->SetName("P");
      point->SetPosition(1.5f * j, 0.25f * k, 0.0f);
      points->AddPointElement(point);
    }
    points->Pack();
    socket->Send(points->GetPackPointer(), points->GetPackSize());
  }
  igtl::GetStatusMessage::Pointer status = igtl::GetStatusMessage::New();
  status->SetDeviceName("client");
  status->Pack();
  socket->Send(status->GetPackPointer(), status->GetPackSize());
}

static void print_vessel(igtl::PolyDataMessage* message)
{
  igtl::PolyDataPointArray* points = message->GetPoints();
  igtl::PolyDataCellArray* strips = message->GetTriangleStrips();
  const int count = points->GetNumberOfPoints();
  float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
  for (int k = 0; k < count; k++) {
    igtlFloat32 point[3];
    points->GetPoint(k, point);
    for (int axis = 0; axis < 3; axis++) {
      low[axis] = std::min(low[axis], point[axis]);
      high[axis] = std::max(high[axis], point[axis]);
    }
  }
  int triangles = 0;
  for (igtlUint32 k = 0; k < strips->GetNumberOfCells(); k++) {
    std::list<igtlUint32> cell;
    strips->GetCell(k, cell);
    triangles += int(cell.size()) - 2;
  }
  std::printf("POLYDATA %s points %d triangles %d\n", message->GetDeviceName(), count, triangles);
  std::printf("bounds %.9g %.9g %.9g %.9g %.9g %.9g\n", low[0], low[1], low[2], high[0], high[1], high[2]);
  for (int k = 0; k < message->GetNumberOfAttributes(); k++) {
    igtl::PolyDataAttribute* attribute = message->GetAttribute(k);
    std::vector<igtlFloat32> values(attribute->GetSize());
    double sum = 0;
    for (igtlUint32 j = 0; j < attribute->GetSize(); j++) {
      attribute->GetNthData(j, &values[j]);
      sum += values[j];
    }
    std::printf("scalars %s type %d values %u first %.9g last %.9g sum %.12g\n", attribute->GetName(),
                int(attribute->GetType()), unsigned(attribute->GetSize()), values.front(), values.back(), sum);
  }
}

int main(int argc, char** argv)
{
  if (argc != 3) {
    return 2;
  }
  igtl::ClientSocket::Pointer socket = igtl::ClientSocket::New();
  if (socket->ConnectToServer("127.0.0.1", std::atoi(argv[1])) != 0) {
    return 3;
  }
  send_frames(socket, std::atoi(argv[2]));

  bool vessel = false, tip = false, status = false;
  while (!(vessel && tip && status)) {
    igtl::MessageHeader::Pointer header = igtl::MessageHeader::New();
    header->InitPack();
    if (socket->Receive(header->GetPackPointer(), header->GetPackSize()) != header->GetPackSize()) {
      return 4;
    }
    header->Unpack();
    const std::string kind = header->GetDeviceType();
    if (kind == "POLYDATA" && !vessel) {
      igtl::PolyDataMessage::Pointer message = igtl::PolyDataMessage::New();
      message->SetMessageHeader(header);
      message->AllocatePack();
      socket->Receive(message->GetPackBodyPointer(), message->GetPackBodySize());
      if (!(message->Unpack(1) & igtl::MessageHeader::UNPACK_BODY)) {
        return 5;
      }
      print_vessel(message);
      vessel = true;
    } else if (kind == "TRANSFORM" && !tip) {
      igtl::TransformMessage::Pointer message = igtl::TransformMessage::New();
      message->SetMessageHeader(header);
      message->AllocatePack();
      socket->Receive(message->GetPackBodyPointer(), message->GetPackBodySize());
      if (!(message->Unpack(1) & igtl::MessageHeader::UNPACK_BODY)) {
        return 6;
      }
      igtl::Matrix4x4 matrix;
      message->GetMatrix(matrix);
      std::printf("TRANSFORM %s", message->GetDeviceName());
      for (int row = 0; row < 3; row++) {
        for (int column = 0; column < 4; column++) {
          std::printf(" %.9g", matrix[row][column]);
        }
      }
      std::printf("\n");
      tip = true;
    } else if (kind == "STATUS" && !status) {
      igtl::StatusMessage::Pointer message = igtl::StatusMessage::New();
      message->SetMessageHeader(header);
      message->AllocatePack();
      socket->Receive(message->GetPackBodyPointer(), message->GetPackBodySize());
      if (!(message->Unpack(1) & igtl::MessageHeader::UNPACK_BODY)) {
        return 7;
      }
      std::printf("STATUS %s %d %s\n", message->GetDeviceName(), message->GetCode(), message->GetStatusString());
      status = true;
    } else {
      socket->Skip(header->GetBodySizeToRead(), 0);
    }
  }
  socket->CloseSocket();
  return 0;
}
