// A client of libOpenIGTLink: what the reference implementation makes of our messages, and what it sends.
//
// igtl_client PORT FRAMES
//
// Sends FRAMES frames, as TRANSFORM or TDATA with POINT, POLYDATA or IMAGE, and as STRING, then a request for the
// status, and prints what comes until a vessel, a tip and a status have been seen.

#include <igtlClientSocket.h>
#include <igtlImageMessage.h>
#include <igtlMessageHeader.h>
#include <igtlPointMessage.h>
#include <igtlPolyDataMessage.h>
#include <igtlStatusMessage.h>
#include <igtlStringMessage.h>
#include <igtlTimeStamp.h>
#include <igtlTrackingDataMessage.h>
#include <igtlTransformMessage.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <vector>

typedef igtl::TimeStamp::Pointer Time;

static void send(igtl::ClientSocket* socket, igtl::MessageBase* message, const char* device, Time time)
{
  message->SetDeviceName(device);
  message->SetTimeStamp(time);
  message->Pack();
  socket->Send(message->GetPackPointer(), message->GetPackSize());
}

static void send_pose(igtl::ClientSocket* socket, Time time, int k)
{
  igtl::Matrix4x4 matrix;
  igtl::IdentityMatrix(matrix);
  matrix[0][3] = 0.5f * k;
  matrix[1][3] = -1.25f;
  if (k % 2 == 0) {
    igtl::TransformMessage::Pointer transform = igtl::TransformMessage::New();
    transform->SetMatrix(matrix);
    send(socket, transform, "ProbeToTracker", time);
    return;
  }
  igtl::TrackingDataMessage::Pointer tools = igtl::TrackingDataMessage::New();
  for (const char* name : {"StylusToTracker", "ProbeToTracker"}) {
    igtl::TrackingDataElement::Pointer tool = igtl::TrackingDataElement::New();
    tool->SetName(name);
    tool->SetType(igtl::TrackingDataElement::TYPE_6D);
    tool->SetMatrix(matrix);
    tools->AddTrackingDataElement(tool);
    // The other tool is elsewhere.
    matrix[2][3] = 0.0f;
  }
  send(socket, tools, "Tracker", time);
}

static void point_of(int j, int k, float point[3])
{
  point[0] = 1.5f * j;
  point[1] = 0.25f * k;
  point[2] = 0.0f;
}

static void send_points(igtl::ClientSocket* socket, Time time, int k)
{
  igtl::PointMessage::Pointer points = igtl::PointMessage::New();
  for (int j = 0; j < 5; j++) {
    float at[3];
    point_of(j, k, at);
    igtl::PointElement::Pointer point = igtl::PointElement::New();
    point->SetName("P");
    point->SetPosition(at);
    points->AddPointElement(point);
  }
  send(socket, points, "LumenContour", time);
}

// A line with all kinds of attributes.
static void send_line(igtl::ClientSocket* socket, Time time, int k)
{
  igtl::PolyDataPointArray::Pointer points = igtl::PolyDataPointArray::New();
  igtl::PolyDataCellArray::Pointer lines = igtl::PolyDataCellArray::New();
  std::list<igtlUint32> line;
  for (int j = 0; j < 5; j++) {
    float at[3];
    point_of(j, k, at);
    points->AddPoint(at);
    line.push_back(j);
  }
  lines->AddCell(line);
  igtl::PolyDataMessage::Pointer message = igtl::PolyDataMessage::New();
  message->SetPoints(points);
  message->SetLines(lines);
  for (int kind : {igtl::PolyDataAttribute::POINT_SCALAR, igtl::PolyDataAttribute::POINT_NORMAL,
                   igtl::PolyDataAttribute::POINT_VECTOR, igtl::PolyDataAttribute::CELL_SCALAR}) {
    igtl::PolyDataAttribute::Pointer attribute = igtl::PolyDataAttribute::New();
    attribute->SetType(kind);
    attribute->SetName("odd");
    std::vector<igtlFloat32> values(15, 0.5f);
    attribute->SetSize(kind == igtl::PolyDataAttribute::CELL_SCALAR ? 1 : 5);
    attribute->SetData(values.data());
    message->AddAttribute(attribute);
  }
  send(socket, message, "LumenContour", time);
}

// A disc of 16 pixels of 0.25 mm about the middle.
static void send_mask(igtl::ClientSocket* socket, Time time)
{
  const int size = 65;
  int sizes[3] = {size, size, 1}, start[3] = {0, 0, 0};
  igtl::ImageMessage::Pointer image = igtl::ImageMessage::New();
  image->SetDimensions(sizes);
  image->SetSubVolume(sizes, start);
  image->SetSpacing(0.25f, 0.25f, 1.0f);
  image->SetScalarTypeToUint8();
  image->AllocateScalars();
  unsigned char* pixels = static_cast<unsigned char*>(image->GetScalarPointer());
  for (int row = 0; row < size; row++) {
    for (int column = 0; column < size; column++) {
      const double radius = std::hypot(row - 32.0, column - 32.0);
      const double share = std::min(1.0, std::max(0.0, (16 - radius) / 4 + 0.5));
      pixels[row * size + column] = (unsigned char)(255 * share);
    }
  }
  send(socket, image, "LumenContour", time);
}

static void send_text(igtl::ClientSocket* socket, Time time, int k)
{
  char text[512];
  std::snprintf(text, sizeof text,
                "{\"time_s\": %g, \"pose\": [1,0,0,%g, 0,1,0,-1.25, 0,0,1,0, 0,0,0,1], "
                "\"contour\": [[0,%g],[1.5,%g],[3,%g],[4.5,%g],[6,%g]]}",
                k / 8.0, 0.5 * k, 0.25 * k, 0.25 * k, 0.25 * k, 0.25 * k, 0.25 * k);
  igtl::StringMessage::Pointer message = igtl::StringMessage::New();
  message->SetString(text);
  send(socket, message, "LumenContour", time);
}

static void send_frames(igtl::ClientSocket* socket, int frames)
{
  for (int k = 0; k < frames; k++) {
    Time time = igtl::TimeStamp::New();
    time->SetTime(igtlUint32(1700000000 + k / 8), igtlUint32(125000000 * (k % 8)));
    if (k % 4 == 3) {
      send_text(socket, time, k);
      continue;
    }
    send_pose(socket, time, k);
    switch (k % 4) {
      case 0: send_points(socket, time, k); break;
      case 1: send_line(socket, time, k); break;
      default: send_mask(socket, time);
    }
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
      std::printf("STATUS %s %d ", message->GetDeviceName(), message->GetCode());
      std::printf("%s\n", message->GetStatusString());
      status = true;
    } else {
      socket->Skip(header->GetBodySizeToRead(), 0);
    }
  }
  socket->CloseSocket();
  return 0;
}
