function [mesh, report] = reconstruct (recording, varargin)
% RECONSTRUCT  From a recording to a mesh of the lumen.
%   mesh = lumenmesh.reconstruct (recording)            a struct, as lumenmesh.write describes, or the name of a file
%   mesh = lumenmesh.reconstruct (recording, 'method', 'cylinders', 'nodes', 24, 'gate', [0.5 1.5])
%   [mesh, report] = ...                                what was done, as text in JSON: jsondecode (report)
%
%   The options are those of `lumenmesh reconstruct --help`, with _ for -. mesh has vertices (V x 3, mm), faces (T x 3,
%   counted from 1) and the arrays over the vertices, such as support and standard_error_mm:
%
%     patch ('Vertices', mesh.vertices, 'Faces', mesh.faces, 'FaceVertexCData', mesh.support, 'FaceColor', 'interp')
  [path, cleanup] = lumenmesh.file_of (recording); %#ok<ASGLU>
  out = [tempname '.mat'];
  remove = onCleanup (@() lumenmesh.forget (out));
  words = lumenmesh.options (varargin);
  report = lumenmesh.command ('reconstruct', path, '-o', out, '--json', words{:});
  mesh = load (out);
end
