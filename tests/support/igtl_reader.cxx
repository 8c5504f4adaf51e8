// Reads OpenIGTLink messages from standard input with the C++ library and prints what they say.
#include <cstdio>
#include <vector>

#include "igtlMessageHeader.h"
#include "igtlPointMessage.h"
#include "igtlPolyDataMessage.h"
#include "igtlStatusMessage.h"
#include "igtlStringMessage.h"
#include "igtlTrackingDataMessage.h"
#include "igtlTransformMessage.h"

template <class Kind>
typename Kind::Pointer unpacked(igtl::MessageHeader::Pointer header, const std::vector<char>& body) {
  typename Kind::Pointer message = Kind::New();
  message->SetMessageHeader(header);
  message->AllocatePack();
  std::copy(body.begin(), body.end(), static_cast<char*>(message->GetPackBodyPointer()));
  if (!(message->Unpack(1) & igtl::MessageHeader::UNPACK_BODY)) std::printf("REFUSED ");
  return message;
}

int main() {
  for (;;) {
    igtl::MessageHeader::Pointer header = igtl::MessageHeader::New();
    header->InitPack();
    if (std::fread(header->GetPackPointer(), 1, header->GetPackSize(), stdin) !=
        static_cast<size_t>(header->GetPackSize()))
      return 0;
    header->Unpack();
    std::vector<char> body(header->GetBodySizeToRead());
    if (std::fread(body.data(), 1, body.size(), stdin) != body.size()) return 1;
    const std::string type = header->GetDeviceType();
    unsigned int seconds, fraction;
    header->GetTimeStamp(&seconds, &fraction);
    std::printf("%s %s %u %u ", type.c_str(), header->GetDeviceName(), seconds, fraction);
    if (type == "TRANSFORM") {
      igtl::Matrix4x4 m;
      unpacked<igtl::TransformMessage>(header, body)->GetMatrix(m);
      for (int i = 0; i < 3; i++)
        for (int j = 0; j < 4; j++) std::printf("%.9g ", m[i][j]);
    } else if (type == "TDATA") {
      igtl::TrackingDataMessage::Pointer message = unpacked<igtl::TrackingDataMessage>(header, body);
      for (int k = 0; k < message->GetNumberOfTrackingDataElements(); k++) {
        igtl::TrackingDataElement::Pointer tool;
        message->GetTrackingDataElement(k, tool);
        float x, y, z;
        tool->GetPosition(&x, &y, &z);
        std::printf("%s %d %.9g %.9g %.9g ", tool->GetName(), tool->GetType(), x, y, z);
      }
    } else if (type == "POLYDATA") {
      igtl::PolyDataMessage::Pointer message = unpacked<igtl::PolyDataMessage>(header, body);
      std::printf("%d %d %d ", message->GetPoints()->GetNumberOfPoints(),
                  message->GetLines()->GetNumberOfCells(), message->GetPolygons()->GetNumberOfCells());
      for (int k = 0; k < message->GetNumberOfAttributes(); k++) {
        igtl::PolyDataAttribute::Pointer attribute = message->GetAttribute(k);
        std::vector<igtlFloat32> data(attribute->GetSize() * attribute->GetNumberOfComponents());
        attribute->GetData(data.data());
        std::printf("%s %.9g ", attribute->GetName(), data.back());
      }
    } else if (type == "STRING") {
      std::printf("%s", unpacked<igtl::StringMessage>(header, body)->GetString());
    } else if (type == "STATUS") {
      igtl::StatusMessage::Pointer message = unpacked<igtl::StatusMessage>(header, body);
      std::printf("%d %s", message->GetCode(), message->GetStatusString());
    }
    std::printf("\n");
  }
}
