function mesh = live (recording, varargin)
% LIVE  The vessel as it grows frame by frame, after the last frame: what a live view ends with.
%   mesh = lumenmesh.live (recording, 'method', 'cylinders')
%   For frames as they come use the Python package from MATLAB: docs/hosts/matlab.md.
  [path, cleanup] = lumenmesh.file_of (recording); %#ok<ASGLU>
  out = [tempname '.mat'];
  remove = onCleanup (@() lumenmesh.forget (out));
  words = lumenmesh.options (varargin);
  lumenmesh.command ('replay', path, '-o', out, words{:});
  mesh = load (out);
end
