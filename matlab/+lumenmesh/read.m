function data = read (path)
% READ  Reads a recording or a mesh.
%   recording = lumenmesh.read ('pullback.mat')   the fields of lumenmesh.write
%   mesh      = lumenmesh.read ('vessel.vtp')     vertices (V x 3, mm), faces (T x 3, counted from 1), arrays (V x 1)
  [~, ~, ending] = fileparts (path);
  if strcmpi (ending, '.mat')
    data = load (path);
    return
  end
  file = [tempname '.mat'];
  cleanup = onCleanup (@() lumenmesh.forget (file));
  if isempty (ending)
    error ('lumenmesh:arguments', '%s: expected a .mat file or a mesh', path);
  end
  lumenmesh.command ('convert', path, '-o', file);
  data = load (file);
end
