function [path, cleanup] = file_of (data)
% FILE_OF  The file of a recording or a mesh; of a struct a temporary one, which is there as long as cleanup is.
  cleanup = [];
  if ischar (data)
    path = data;
    return
  end
  path = [tempname '.mat'];
  cleanup = onCleanup (@() lumenmesh.forget (path));
  lumenmesh.write (data, path);
end
